// RoomLight for ARKit in one file: converts an ARFrame to the message of `roomlight serve` (docs/wire.md), with a
// small client. Copy it into an app. It needs Swift 5, iOS 15, a device with LiDAR, and only Apple's frameworks.
//
// It has never been compiled, only parsed, because no Swift compiler was available. tests/client/test_swift_source.py
// compares its constants, names and choices with the server's. The first part needs only Foundation; there
// `wireVectorMessages` packs the shared test vector, to check this file on a machine with a compiler.
//
//     let client = RoomLightClient(server: URL(string: "https://light.example")!, token: "...")
//     try await client.open()
//     // in session(_:didUpdate:), after the last push has returned:
//     let index = client.nextIndex()
//     let message = try RoomLightFrame(frame, index: index).packed()    // at once: ARKit stops if the app keeps frames
//     Task { try await client.push(message, index: index) }
//     let light = try await client.mainLight(at: [0.2, -0.1, -1.5])

import Foundation

/// A frame that the server would refuse, with the server's name of the field.
public struct RoomLightRefusal: Error {
    public let field: String
    public let rule: String
}

// MARK: - A frame as bytes

/// A frame: colour, depth and camera pose. `packed()` returns its message.
public struct RoomLightFrame {
    static let magic = "RLF1"
    static let version = 1
    static let maxHeaderBytes = 16_384

    public enum ColourEncoding: String {
        case jpeg = "jpeg"
        case png = "png"
        case heic = "heic"
        case rgb8 = "rgb8"
        case linearF32 = "linear_f32"
    }

    public enum DepthFormat: String {
        case uint16Millimetres = "uint16_mm"
        case float16Metres = "float16_m"
        case float32Metres = "float32_m"
    }

    public enum PlaneEncoding: String {
        case raw = "raw"
        case png = "png"
        case zstd = "zstd"
    }

    public enum TrackingState: String {
        case normal = "normal"
        case limited = "limited"
        case notAvailable = "not_available"
    }

    /// Depth or confidence: row by row, little-endian, in the view of the colour image.
    public struct Plane {
        public var width: Int
        public var height: Int
        public var data: Data
        public var encoding = PlaneEncoding.raw

        public init(width: Int, height: Int, data: Data, encoding: PlaneEncoding = .raw) {
            self.width = width
            self.height = height
            self.data = data
            self.encoding = encoding
        }
    }

    /// In pixels of the colour image; pixel centres are at half integers.
    public struct Intrinsics {
        public var fx: Double
        public var fy: Double
        public var cx: Double
        public var cy: Double
        public var width: Int
        public var height: Int

        public init(fx: Double, fy: Double, cx: Double, cy: Double, width: Int, height: Int) {
            self.fx = fx
            self.fy = fy
            self.cx = cx
            self.cy = cy
            self.width = width
            self.height = height
        }
    }

    public var index: Int?
    public var colour: Data
    public var colourEncoding: ColourEncoding
    public var depth: Plane
    public var depthFormat: DepthFormat
    /// One byte per depth pixel: 0 low, 1 medium, 2 high.
    public var confidence: Plane?
    public var intrinsics: Intrinsics
    /// 16 numbers, column by column, as simd_float4x4 is stored; metres, y up.
    public var cameraToWorld: [Double]
    public var timestampSeconds: Double?
    /// Exposure, e.g. shutter seconds x ISO / 100; the server divides radiance by it.
    public var exposure = 1.0
    public var trackingState = TrackingState.normal

    public init(
        index: Int?, colour: Data, colourEncoding: ColourEncoding, depth: Plane, depthFormat: DepthFormat,
        confidence: Plane?, intrinsics: Intrinsics, cameraToWorld: [Double]
    ) {
        self.index = index
        self.colour = colour
        self.colourEncoding = colourEncoding
        self.depth = depth
        self.depthFormat = depthFormat
        self.confidence = confidence
        self.intrinsics = intrinsics
        self.cameraToWorld = cameraToWorld
    }

    /// The message: magic, length of the header (UInt32, little-endian), header, colour, depth, confidence; no gaps.
    public func packed() throws -> Data {
        guard cameraToWorld.count == 16 else {
            throw RoomLightRefusal(field: "camera_to_world", rule: "must be 16 numbers, column by column, got \(cameraToWorld.count)")
        }
        let text = Data(try header().written().utf8)
        guard text.count <= RoomLightFrame.maxHeaderBytes else {
            throw RoomLightRefusal(field: "header length", rule: "at most \(RoomLightFrame.maxHeaderBytes), got \(text.count)")
        }
        var message = Data(RoomLightFrame.magic.utf8)
        withUnsafeBytes(of: UInt32(text.count).littleEndian) { message.append(contentsOf: $0) }
        message.append(text)
        message.append(colour)
        message.append(depth.data)
        if let confidence = confidence {
            message.append(confidence.data)
        }
        return message
    }

    func header() -> WireJSON {
        let colourPart: [String: WireJSON?] = [
            "encoding": .word(colourEncoding.rawValue),
            "bytes": .whole(colour.count),
        ]
        let depthPart: [String: WireJSON?] = [
            "format": .word(depthFormat.rawValue),
            "encoding": .word(depth.encoding.rawValue),
            "width": .whole(depth.width),
            "height": .whole(depth.height),
            "bytes": .whole(depth.data.count),
        ]
        var confidencePart: WireJSON?
        if let confidence = confidence {
            let part: [String: WireJSON?] = [
                "format": .word("uint8"),
                "encoding": .word(confidence.encoding.rawValue),
                "width": .whole(confidence.width),
                "height": .whole(confidence.height),
                "bytes": .whole(confidence.data.count),
            ]
            confidencePart = .object(part)
        }
        let intrinsicsPart: [String: WireJSON?] = [
            "fx": .number(intrinsics.fx),
            "fy": .number(intrinsics.fy),
            "cx": .number(intrinsics.cx),
            "cy": .number(intrinsics.cy),
            "width": .whole(intrinsics.width),
            "height": .whole(intrinsics.height),
        ]
        let whole: [String: WireJSON?] = [
            "version": .whole(RoomLightFrame.version),
            "index": index.map { WireJSON.whole($0) },
            "colour": .object(colourPart),
            "depth": .object(depthPart),
            "confidence": confidencePart,
            "intrinsics": .object(intrinsicsPart),
            "camera_to_world": .list(cameraToWorld.map { WireJSON.number($0) }),
            "timestamp_s": timestampSeconds.map { WireJSON.number($0) },
            "exposure": .number(exposure),
            "tracking_state": .word(trackingState.rawValue),
        ]
        return .object(whole)
    }
}

/// The canonical JSON of a header, the same in all clients: sorted keys, no spaces, no nil fields, whole numbers
/// without a decimal point. Words are the raw values of the enums above; none of them needs an escape.
enum WireJSON {
    case word(String)
    case whole(Int)
    case number(Double)
    case list([WireJSON])
    case object([String: WireJSON?])

    func written() throws -> String {
        switch self {
        case .word(let word):
            return "\"\(word)\""
        case .whole(let value):
            return String(value)
        case .number(let value):
            guard value.isFinite else {
                throw RoomLightRefusal(field: "header", rule: "numbers must be finite, got \(value)")
            }
            if value == value.rounded() && abs(value) < 9_007_199_254_740_992 {
                return String(Int64(value))
            }
            return "\(value)" // the shortest form, with an exponent below 0.0001: 1.5e-05
        case .list(let items):
            return "[" + (try items.map { try $0.written() }).joined(separator: ",") + "]"
        case .object(let fields):
            var pairs: [String] = []
            for key in fields.keys.sorted() {
                if let found = fields[key], let value = found {
                    pairs.append("\"\(key)\":" + (try value.written()))
                }
            }
            return "{" + pairs.joined(separator: ",") + "}"
        }
    }
}

/// Packs the frames of `tests/core/wire_vector.json`. Joined, the messages must equal `wire_vector.bin`.
func wireVectorMessages(json: Data) throws -> [Data] {
    func wrong(_ field: String) -> RoomLightRefusal { RoomLightRefusal(field: field, rule: "as in wire_vector.json") }
    func bytes(_ hex: String?) -> Data {
        let digits = Array(hex ?? "")
        return Data(stride(from: 0, to: digits.count, by: 2).compactMap { UInt8(String(digits[$0...$0 + 1]), radix: 16) })
    }
    guard let whole = try JSONSerialization.jsonObject(with: json) as? [String: Any],
        let vectors = whole["vectors"] as? [[String: Any]]
    else { throw wrong("vectors") }
    return try vectors.map { vector in
        guard let header = vector["header"] as? [String: Any], let parts = vector["parts"] as? [String: String],
            let colour = header["colour"] as? [String: Any], let depth = header["depth"] as? [String: Any],
            let k = header["intrinsics"] as? [String: Double], let pose = header["camera_to_world"] as? [Double],
            let colourEncoding = RoomLightFrame.ColourEncoding(rawValue: colour["encoding"] as? String ?? ""),
            let depthFormat = RoomLightFrame.DepthFormat(rawValue: depth["format"] as? String ?? "")
        else { throw wrong("header") }
        func plane(_ name: String) throws -> RoomLightFrame.Plane? {
            guard let part = header[name] as? [String: Any] else { return nil }
            guard let width = part["width"] as? Int, let height = part["height"] as? Int,
                let encoding = RoomLightFrame.PlaneEncoding(rawValue: part["encoding"] as? String ?? "")
            else { throw wrong(name) }
            return RoomLightFrame.Plane(width: width, height: height, data: bytes(parts[name]), encoding: encoding)
        }
        guard let depthPlane = try plane("depth") else { throw wrong("depth") }
        let intrinsics = RoomLightFrame.Intrinsics(
            fx: k["fx"] ?? 0, fy: k["fy"] ?? 0, cx: k["cx"] ?? 0, cy: k["cy"] ?? 0, width: Int(k["width"] ?? 0),
            height: Int(k["height"] ?? 0))
        var frame = RoomLightFrame(
            index: header["index"] as? Int, colour: bytes(parts["colour"]), colourEncoding: colourEncoding,
            depth: depthPlane, depthFormat: depthFormat, confidence: try plane("confidence"), intrinsics: intrinsics,
            cameraToWorld: pose)
        frame.timestampSeconds = header["timestamp_s"] as? Double
        frame.exposure = header["exposure"] as? Double ?? 1
        frame.trackingState = RoomLightFrame.TrackingState(rawValue: header["tracking_state"] as? String ?? "") ?? .normal
        return try frame.packed()
    }
}

// MARK: - An ARFrame as a frame

#if os(iOS) && canImport(ARKit)
    import ARKit
    import CoreImage
    import ImageIO

    extension RoomLightFrame {
        /// Shared by all frames, because it is slow to create.
        static let imageContext = CIContext(options: [.cacheIntermediates: false])

        /// Copies what it needs from an ARFrame. The configuration must have the `frameSemantics` `.sceneDepth` or
        /// `.smoothedSceneDepth`, and a video format of 4:3, the aspect of the depth map.
        ///
        /// ARKit gives image, depth and `camera.transform` in the orientation of the sensor (landscape), however the
        /// phone is held. They match each other and are not rotated. `longest`: longest side of the image in pixels;
        /// larger images are scaled down. The server works at 320 x 240, and 640 keeps lamps sharp.
        public init(_ frame: ARFrame, index: Int? = nil, longest: Int = 640, quality: Double = 0.85) throws {
            guard let sceneDepth = frame.smoothedSceneDepth ?? frame.sceneDepth else {
                throw RoomLightRefusal(field: "depth", rule: "frameSemantics must include .sceneDepth, on a device with LiDAR")
            }
            let (image, width, height) = try RoomLightFrame.jpeg(frame.capturedImage, longest: longest, quality: quality)
            let resolution = frame.camera.imageResolution
            let (scaleX, scaleY) = (Double(width) / Double(resolution.width), Double(height) / Double(resolution.height))
            let k = frame.camera.intrinsics // columns: (fx 0 0), (0 fy 0), (cx cy 1), at imageResolution
            let intrinsics = Intrinsics(
                fx: Double(k.columns.0.x) * scaleX, fy: Double(k.columns.1.y) * scaleY,
                cx: Double(k.columns.2.x) * scaleX, cy: Double(k.columns.2.y) * scaleY, width: width, height: height)
            let pose = frame.camera.transform
            let columns = [pose.columns.0, pose.columns.1, pose.columns.2, pose.columns.3]
            let depth = try RoomLightFrame.plane(sceneDepth.depthMap, type: kCVPixelFormatType_DepthFloat32, pixelBytes: 4)
            var confidence: Plane?
            if let map = sceneDepth.confidenceMap {
                // ARConfidenceLevel: low 0, medium 1, high 2, as on the wire
                confidence = try RoomLightFrame.plane(map, type: kCVPixelFormatType_OneComponent8, pixelBytes: 1)
            }
            self.init(
                index: index, colour: image, colourEncoding: .jpeg, depth: depth, depthFormat: .float32Metres,
                confidence: confidence, intrinsics: intrinsics,
                cameraToWorld: columns.flatMap { [Double($0.x), Double($0.y), Double($0.z), Double($0.w)] })
            timestampSeconds = frame.timestamp
            exposure = RoomLightFrame.exposure(of: frame)
            switch frame.camera.trackingState {
            case .normal: trackingState = .normal
            case .limited: trackingState = .limited
            case .notAvailable: trackingState = .notAvailable
            }
        }

        /// Shutter seconds x ISO / 100. The ISO is only in the EXIF data, from iOS 16 on. Without it the exposure is 1,
        /// and light is relative to each frame. (`exposureOffset` is the meter's distance from its target, not the
        /// exposure.)
        static func exposure(of frame: ARFrame) -> Double {
            if #available(iOS 16.0, *) {
                let exif = frame.exifData
                let iso = (exif["ISOSpeedRatings"] as? [NSNumber])?.first?.doubleValue
                let shutter = (exif["ExposureTime"] as? NSNumber)?.doubleValue ?? frame.camera.exposureDuration
                if let iso = iso, iso > 0, shutter > 0 {
                    return shutter * iso / 100
                }
            }
            return 1
        }

        static func jpeg(_ buffer: CVPixelBuffer, longest: Int, quality: Double) throws -> (Data, Int, Int) {
            let (fromWidth, fromHeight) = (CVPixelBufferGetWidth(buffer), CVPixelBufferGetHeight(buffer))
            let scale = min(1, Double(longest) / Double(max(fromWidth, fromHeight)))
            let width = Int((Double(fromWidth) * scale).rounded())
            let height = Int((Double(fromHeight) * scale).rounded())
            let shrink = CGAffineTransform(
                scaleX: CGFloat(width) / CGFloat(fromWidth), y: CGFloat(height) / CGFloat(fromHeight))
            let image = CIImage(cvPixelBuffer: buffer).transformed(by: shrink)
                .cropped(to: CGRect(x: 0, y: 0, width: width, height: height))
            let option = CIImageRepresentationOption(rawValue: kCGImageDestinationLossyCompressionQuality as String)
            guard let space = CGColorSpace(name: CGColorSpace.sRGB),
                let data = imageContext.jpegRepresentation(of: image, colorSpace: space, options: [option: quality])
            else { throw RoomLightRefusal(field: "colour", rule: "must be an image that can be encoded as JPEG") }
            return (data, width, height)
        }

        /// Copies the rows of a pixel buffer without their padding.
        static func plane(_ buffer: CVPixelBuffer, type: OSType, pixelBytes: Int) throws -> Plane {
            CVPixelBufferLockBaseAddress(buffer, .readOnly)
            defer { CVPixelBufferUnlockBaseAddress(buffer, .readOnly) }
            guard CVPixelBufferGetPixelFormatType(buffer) == type, let base = CVPixelBufferGetBaseAddress(buffer) else {
                throw RoomLightRefusal(field: "depth", rule: "must be a pixel buffer of type \(type)")
            }
            let (width, height) = (CVPixelBufferGetWidth(buffer), CVPixelBufferGetHeight(buffer))
            let rowBytes = CVPixelBufferGetBytesPerRow(buffer)
            var data = Data(capacity: width * height * pixelBytes)
            for row in 0..<height {
                data.append(contentsOf: UnsafeRawBufferPointer(start: base + row * rowBytes, count: width * pixelBytes))
            }
            return Plane(width: width, height: height, data: data)
        }
    }
#endif

// MARK: - A client

#if canImport(Darwin)
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
            /// Share of the irradiance on a surface that faces the light, 0 to 1: how much darker its shadow is.
            public let shadow_strength: Float
            /// 1: brighter than any surface that the room's light explains; toward 0: it may be a bright surface.
            public let emitted: Float
            /// Equal from frame to frame at a tracked probe.
            public let number: Int
        }

        /// The main light. What servers of earlier versions do not send is nil.
        public struct MainLight: Decodable {
            public let direction: [Float]
            public let intensity: [Float]
            public let radius_deg: Float?
            public let shadow_strength: Float?
            public let emitted: Float?
            public let number: Int?
            /// Up to three lights, the strongest first. At a tracked probe the main light turns from one to another at
            /// a bounded rate, while these stay in their places.
            public let lights: [LightSource]?
            /// Fraction of the sphere that was observed, 0 to 1.
            public let coverage: Double
        }

        /// 27 radiance coefficients, R0..R8 G0..G8 B0..B8, in the layout of ARDirectionalLightEstimate.
        public struct Harmonics: Decodable {
            public let coefficients: [Float]
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

        /// The index of the next frame: 0, 1, 2 ...
        public func nextIndex() -> Int {
            lock.lock()
            defer { lock.unlock() }
            next += 1
            return next - 1
        }

        /// Opens the session. Options are the fields of `SessionRequest`: mode, height, reference_exposure,
        /// use_limited_tracking, min_confidence, unknown_depth.
        public func open(options: [String: Any] = [:]) async throws {
            let body = try JSONSerialization.data(withJSONObject: options)
            _ = try await send("PUT", [], body: body, type: "application/json")
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
#endif
