// A frame as the message of `roomlight serve` (docs/wire.md). Only Foundation: it compiles wherever Swift does.

import Foundation

/// A frame that the server would refuse, with the server's name of the field.
public struct RoomLightRefusal: Error {
    public let field: String
    public let rule: String

    public init(field: String, rule: String) {
        self.field = field
        self.rule = rule
    }
}

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
    /// nil: the camera measures none, and the server estimates it.
    public var depth: Plane?
    public var depthFormat: DepthFormat
    /// Whether a network made the depth; nil: no.
    public var depthEstimated: Bool?
    /// One byte per depth pixel: 0 low, 1 medium, 2 high.
    public var confidence: Plane?
    public var intrinsics: Intrinsics
    /// 16 numbers, column by column, as simd_float4x4 is stored; metres, y up.
    public var cameraToWorld: [Double]
    public var timestampSeconds: Double?
    /// Exposure, e.g. shutter seconds x ISO / 100; the server divides radiance by it.
    public var exposure = 1.0
    /// Whether the camera changes exposure and white balance and `exposure` does not say by how much; nil: by the rule
    /// of the wire format.
    public var autoExposed: Bool?
    public var trackingState = TrackingState.normal

    public init(
        index: Int?, colour: Data, colourEncoding: ColourEncoding, depth: Plane?, depthFormat: DepthFormat,
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
        if let depth = depth {
            message.append(depth.data)
        }
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
        var measuredPart: WireJSON?
        if let depth = depth {
            let depthPart: [String: WireJSON?] = [
                "format": .word(depthFormat.rawValue),
                "encoding": .word(depth.encoding.rawValue),
                "width": .whole(depth.width),
                "height": .whole(depth.height),
                "bytes": .whole(depth.data.count),
                "estimated": depthEstimated.map { WireJSON.truth($0) },
            ]
            measuredPart = .object(depthPart)
        }
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
            "depth": measuredPart,
            "confidence": confidencePart,
            "intrinsics": .object(intrinsicsPart),
            "camera_to_world": .list(cameraToWorld.map { WireJSON.number($0) }),
            "timestamp_s": timestampSeconds.map { WireJSON.number($0) },
            "exposure": .number(exposure),
            "auto_exposed": autoExposed.map { WireJSON.truth($0) },
            "tracking_state": .word(trackingState.rawValue),
        ]
        return .object(whole)
    }
}
