// The client on a running server, whose address is in ROOMLIGHT_SERVER.

import Foundation
import RoomLightARKit
import RoomLightWire
import XCTest

final class ClientTests: XCTestCase {
    /// A grey wall 1.5 m away, with a bright square; without depth if `depth` is false.
    private func frame(_ index: Int, depth: Bool) -> RoomLightFrame {
        let (width, height) = (64, 48)
        var colour = Data(repeating: 90, count: 3 * width * height)
        for row in 4..<12 {
            for column in 40..<52 {
                let at = 3 * (row * width + column)
                colour.replaceSubrange(at..<at + 3, with: [255, 255, 255])
            }
        }
        let metres = [Float](repeating: 1.5, count: width * height).withUnsafeBytes { Data($0) }
        let plane = RoomLightFrame.Plane(width: width, height: height, data: metres)
        return RoomLightFrame(
            index: index, colour: colour, colourEncoding: .rgb8, depth: depth ? plane : nil,
            depthFormat: .float32Metres, confidence: nil,
            intrinsics: .init(fx: 60, fy: 60, cx: 32, cy: 24, width: width, height: height),
            cameraToWorld: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    }

    private func client(id: String = UUID().uuidString) throws -> RoomLightClient {
        guard let text = ProcessInfo.processInfo.environment["ROOMLIGHT_SERVER"], let server = URL(string: text) else {
            throw XCTSkip("ROOMLIGHT_SERVER must be the address of a running server")
        }
        return RoomLightClient(server: server, id: id)
    }

    func testASessionGivesLight() async throws {
        let client = try client()
        try await client.open()
        for depth in [true, false] {
            let index = client.nextIndex()
            let result = try await client.push(try frame(index, depth: depth).packed(), index: index)
            XCTAssertEqual(result.status, "processed")
        }
        let point = SIMD3<Float>(0.1, -0.2, -1)
        let main = try await client.mainLight(at: point)
        XCTAssertEqual(main.direction.count, 3)
        XCTAssertGreaterThan(main.intensity.max() ?? 0, 0)
        XCTAssertGreaterThan(main.coverage, 0)
        let total = try await client.harmonics(at: point)
        let ambient = try await client.harmonics(at: point, kind: "ambient")
        XCTAssertEqual(total.coefficients.count, 27)
        XCTAssertEqual(total.phase, "condon-shortley")
        XCTAssertGreaterThan(total.coefficients[0], ambient.coefficients[0])
        let map = try await client.probe(point, ["format": "ktx2", "size": "16"])
        XCTAssertEqual(map.prefix(6).dropFirst(), Data("KTX 2".utf8))
        let again = try self.client(id: client.id)
        try await again.open()
        XCTAssertEqual(again.nextIndex(), 2)
        try await client.close()
    }

    func testAnErrorSaysWhatWasWrong() async throws {
        let client = try client()
        try await client.open()
        do {
            _ = try await client.push(Data("RLF1".utf8), index: 0)
            XCTFail("a message without a header must be refused")
        } catch let problem as RoomLightClient.Problem {
            XCTAssertEqual(problem.status, 422)
            XCTAssertFalse(problem.detail.isEmpty)
        }
        try await client.close()
    }
}
