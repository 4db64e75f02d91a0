// swift-tools-version:5.7
// RoomLightWire packs frames and needs only Foundation; RoomLightARKit adds ARKit's frames and a client.

import PackageDescription

let package = Package(
    name: "RoomLight",
    platforms: [.iOS(.v15), .macOS(.v12)],
    products: [
        .library(name: "RoomLightWire", targets: ["RoomLightWire"]),
        .library(name: "RoomLightARKit", targets: ["RoomLightARKit"]),
    ],
    targets: [
        .target(name: "RoomLightWire"),
        .target(name: "RoomLightARKit", dependencies: ["RoomLightWire"]),
        .testTarget(name: "RoomLightWireTests", dependencies: ["RoomLightWire"]),
        .testTarget(name: "RoomLightARKitTests", dependencies: ["RoomLightARKit"]),
    ]
)
