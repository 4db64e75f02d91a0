// One session on a server, over HTTP.

import Foundation
import RoomLightWire

#if canImport(FoundationNetworking)
    import FoundationNetworking // URLSession, on other systems than Apple's
#endif

/// One session on a server. Frames may be pushed before earlier ones are processed; the newest one wins.
@available(iOS 15.0, macOS 12.0, *)
public final class RoomLightClient: @unchecked Sendable {
    public struct FrameResult: Decodable {
        public let index: Int
        /// processed, superseded, skipped or queued.
        public let status: String
    }

    /// One light: unit direction toward it in the world, and its linear RGB irradiance on a surface that faces it.
    public struct LightSource: Decodable {
        public let direction: [Float]
        public let intensity: [Float]
        /// Angular radius in degrees of a round light of the same spread.
        public let radius_deg: Float
        /// Share of the irradiance on a surface that faces the light, 0 to 1: how much darker its shadow is there.
        public let shadow_strength: Float
        /// 1: brighter than any surface that the room's light explains; toward 0: it may be a bright surface.
        public let emitted: Float
        /// Equal from frame to frame at a tracked probe.
        public let number: Int
    }

    /// The main light.
    public struct MainLight: Decodable {
        public let direction: [Float]
        public let intensity: [Float]
        public let radius_deg: Float
        public let shadow_strength: Float
        public let emitted: Float
        public let number: Int
        /// Up to three lights, the strongest first. At a tracked probe the main light turns from one to another at
        /// a bounded rate, while these stay in their places.
        public let lights: [LightSource]
        /// Fraction of the sphere that was observed, 0 to 1.
        public let coverage: Double
    }

    /// 27 radiance coefficients, R0..R8 G0..G8 B0..B8, in the layout of ARDirectionalLightEstimate, of the orthonormal
    /// functions of 1, -y, z, -x, xy, -yz, 3z2-1, -xz, x2-y2 in world axes. The signs are RoomLight's: Apple documents
    /// none.
    public struct Harmonics: Decodable {
        public let coefficients: [Float]
        /// condon-shortley: the functions of y, x, yz and xz are negative, as above.
        public let phase: String
        public let coverage: Double
    }

    /// The server's problem details (RFC 9457). After status 429 drop the frame and send a newer one.
    public struct Problem: Error, Decodable {
        public let title: String
        public let status: Int
        public let detail: String
        public let field: String?
        public let rule: String?
    }

    public let id: String
    private let server: URL
    private let token: String?
    private let session: URLSession
    private let lock = NSLock()
    private var next = 0

    public init(server: URL, token: String? = nil, id: String = UUID().uuidString, session: URLSession = .shared) {
        self.server = server
        self.token = token
        self.id = id
        self.session = session
    }

    /// Pairs this phone by the address in the server's QR code; returns the phone's own token. A code works once.
    /// The server's certificate must be trusted by `session`.
    public static func pair(link: URL, session: URLSession = .shared) async throws -> String {
        struct Paired: Decodable { let token: String }
        guard var parts = URLComponents(url: link, resolvingAgainstBaseURL: true),
            let code = parts.fragment, code.hasPrefix("pair="), parts.path.hasSuffix("/phone")
        else { throw URLError(.badURL) }
        parts.fragment = nil
        parts.path = parts.path.dropLast("phone".count) + "v1/phones"
        guard let url = parts.url else { throw URLError(.badURL) }
        var request = URLRequest(url: url)
        request.httpMethod = "POST"
        request.httpBody = try JSONEncoder().encode(["code": String(code.dropFirst("pair=".count))])
        request.setValue("application/json", forHTTPHeaderField: "Content-Type")
        return try JSONDecoder().decode(Paired.self, from: try await answer(to: request, session)).token
    }

    /// The index of the next frame: 0, 1, 2 ..., above all frames that the server had at `open`.
    public func nextIndex() -> Int {
        lock.lock()
        defer { lock.unlock() }
        next += 1
        return next - 1
    }

    /// Opens the session, or continues an existing one. Options are the fields of `SessionRequest`: model, height,
    /// reference_exposure, use_limited_tracking, min_confidence, unknown_depth.
    public func open(options: [String: Any] = [:]) async throws {
        struct Frames: Decodable { let last_index: Int? }
        struct State: Decodable { let frames: Frames }
        let body = try JSONSerialization.data(withJSONObject: options)
        let answer = try await send("PUT", [], body: body, type: "application/json")
        continueAfter(try JSONDecoder().decode(State.self, from: answer).frames.last_index ?? -1)
    }

    private func continueAfter(_ index: Int) {
        lock.lock()
        defer { lock.unlock() }
        next = max(next, index + 1)
    }

    /// Sends a packed frame. The index must be the one in its header.
    public func push(_ message: Data, index: Int) async throws -> FrameResult {
        let answer = try await send("PUT", ["frames", String(index)], body: message, type: "application/vnd.roomlight.frame")
        return try JSONDecoder().decode(FrameResult.self, from: answer)
    }

    /// The main light at a point.
    public func mainLight(at position: SIMD3<Float>) async throws -> MainLight {
        try JSONDecoder().decode(MainLight.self, from: await probe(position, ["format": "main_light"]))
    }

    /// Harmonics at a point. `kind`: total, or ambient (without the main light).
    public func harmonics(at position: SIMD3<Float>, kind: String = "total") async throws -> Harmonics {
        let query = ["format": "sh", "basis": "arkit", "kind": kind]
        return try JSONDecoder().decode(Harmonics.self, from: await probe(position, query))
    }

    /// The bytes of the light in any form, e.g. `["format": "ktx2", "size": "64"]`.
    public func probe(_ position: SIMD3<Float>, _ form: [String: String]) async throws -> Data {
        let place = ["x": "\(position.x)", "y": "\(position.y)", "z": "\(position.z)"]
        return try await send("GET", ["probe"], query: form.merging(place) { form, _ in form })
    }

    /// Deletes the session and everything that the server stores for it.
    public func close() async throws {
        _ = try await send("DELETE", [])
    }

    private func send(
        _ method: String, _ path: [String], query: [String: String] = [:], body: Data? = nil, type: String? = nil
    ) async throws -> Data {
        var address = server.appendingPathComponent("v1/sessions").appendingPathComponent(id)
        for part in path {
            address.appendPathComponent(part)
        }
        var parts = URLComponents(url: address, resolvingAgainstBaseURL: false)
        if !query.isEmpty {
            parts?.queryItems = query.map { URLQueryItem(name: $0.key, value: $0.value) }
        }
        guard let url = parts?.url else { throw URLError(.badURL) }
        var request = URLRequest(url: url)
        request.httpMethod = method
        request.httpBody = body
        if let type = type {
            request.setValue(type, forHTTPHeaderField: "Content-Type")
        }
        if let token = token {
            request.setValue("Bearer \(token)", forHTTPHeaderField: "Authorization")
        }
        return try await Self.answer(to: request, session)
    }

    private static func answer(to request: URLRequest, _ session: URLSession) async throws -> Data {
        let (data, response) = try await session.data(for: request)
        guard let answer = response as? HTTPURLResponse else { throw URLError(.badServerResponse) }
        guard (200..<300).contains(answer.statusCode) else {
            if let problem = try? JSONDecoder().decode(Problem.self, from: data) {
                throw problem
            }
            throw URLError(.badServerResponse)
        }
        return data
    }
}
