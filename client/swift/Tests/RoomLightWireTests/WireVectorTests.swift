// The test vector that all clients share: tests/core/wire_vector.json, packed, must be wire_vector.bin.

import Foundation
import XCTest

import RoomLightWire

final class WireVectorTests: XCTestCase {
    func testTheSharedVector() throws {
        var folder = URL(fileURLWithPath: #filePath)
        for _ in 0..<5 {
            folder.deleteLastPathComponent() // WireVectorTests.swift, RoomLightWireTests, Tests, swift, client
        }
        folder.appendPathComponent("tests/core")
        let json = try Data(contentsOf: folder.appendingPathComponent("wire_vector.json"))
        let expected = try Data(contentsOf: folder.appendingPathComponent("wire_vector.bin"))
        let packed = try messages(json: json)
        XCTAssertEqual(packed.reduce(Data(), +), expected)
    }

    func testAnInvalidFrameIsRefused() {
        let plane = RoomLightFrame.Plane(width: 1, height: 1, data: Data([0, 0]))
        let camera = RoomLightFrame.Intrinsics(fx: 1, fy: 1, cx: 0.5, cy: 0.5, width: 1, height: 1)
        func frame(_ pose: [Double]) -> RoomLightFrame {
            RoomLightFrame(
                index: 0, colour: Data([1]), colourEncoding: .jpeg, depth: plane, depthFormat: .uint16Millimetres,
                confidence: nil, intrinsics: camera, cameraToWorld: pose)
        }
        XCTAssertThrowsError(try frame([1]).packed())
        XCTAssertThrowsError(try frame([Double](repeating: .nan, count: 16)).packed())
    }

    private func messages(json: Data) throws -> [Data] {
        let whole = try XCTUnwrap(JSONSerialization.jsonObject(with: json) as? [String: Any])
        let vectors = try XCTUnwrap(whole["vectors"] as? [[String: Any]])
        return try vectors.map { try frame($0).packed() }
    }

    private func frame(_ vector: [String: Any]) throws -> RoomLightFrame {
        let header = try XCTUnwrap(vector["header"] as? [String: Any])
        let parts = try XCTUnwrap(vector["parts"] as? [String: String])
        let colour = try XCTUnwrap(header["colour"] as? [String: Any])
        let depth = header["depth"] as? [String: Any]
        let k = try XCTUnwrap(header["intrinsics"] as? [String: Any])
        let pose = try XCTUnwrap(header["camera_to_world"] as? [Any])
        let encoding = RoomLightFrame.ColourEncoding(rawValue: colour["encoding"] as? String ?? "")
        let format = RoomLightFrame.DepthFormat(rawValue: depth?["format"] as? String ?? "float32_m")
        let camera = RoomLightFrame.Intrinsics(
            fx: try number(k["fx"]), fy: try number(k["fy"]), cx: try number(k["cx"]), cy: try number(k["cy"]),
            width: Int(try number(k["width"])), height: Int(try number(k["height"])))
        var frame = RoomLightFrame(
            index: try header["index"].map { Int(try number($0)) }, colour: bytes(parts["colour"]),
            colourEncoding: try XCTUnwrap(encoding), depth: try plane("depth", header, parts),
            depthFormat: try XCTUnwrap(format), confidence: try plane("confidence", header, parts),
            intrinsics: camera, cameraToWorld: try pose.map { try number($0) })
        frame.depthEstimated = depth?["estimated"] as? Bool
        frame.timestampSeconds = try header["timestamp_s"].map { try number($0) }
        frame.exposure = try header["exposure"].map { try number($0) } ?? 1
        frame.autoExposed = header["auto_exposed"] as? Bool
        let state = header["tracking_state"] as? String ?? "normal"
        frame.trackingState = try XCTUnwrap(RoomLightFrame.TrackingState(rawValue: state))
        return frame
    }

    private func plane(
        _ name: String, _ header: [String: Any], _ parts: [String: String]
    ) throws -> RoomLightFrame.Plane? {
        guard let part = header[name] as? [String: Any] else { return nil }
        let encoding = RoomLightFrame.PlaneEncoding(rawValue: part["encoding"] as? String ?? "raw")
        return RoomLightFrame.Plane(
            width: Int(try number(part["width"])), height: Int(try number(part["height"])), data: bytes(parts[name]),
            encoding: try XCTUnwrap(encoding))
    }

    /// JSON's numbers are NSNumber on Apple's systems, and Int or Double elsewhere.
    private func number(_ value: Any?) throws -> Double {
        if let double = value as? Double { return double }
        if let whole = value as? Int { return Double(whole) }
        return try XCTUnwrap(value as? NSNumber).doubleValue
    }

    private func bytes(_ hex: String?) -> Data {
        let digits = Array(hex ?? "")
        return Data(stride(from: 0, to: digits.count, by: 2).compactMap { UInt8(String(digits[$0...$0 + 1]), radix: 16) })
    }
}
