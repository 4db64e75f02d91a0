// An ARFrame as a frame to send. On other systems than iOS this file is empty.

#if os(iOS) && canImport(ARKit)
    import ARKit
    import CoreImage
    import ImageIO
    import RoomLightWire

    extension RoomLightFrame {
        /// Shared by all frames, because it is slow to create. Without `highQualityDownsample` iOS skips pixels.
        static let imageContext = CIContext(options: [.cacheIntermediates: false, .highQualityDownsample: true])

        /// Copies what it needs from an ARFrame. On a device with LiDAR the configuration should have the
        /// `frameSemantics` `.sceneDepth` or `.smoothedSceneDepth`, and a video format of 4:3, the aspect of the depth
        /// map. Without them the frame has no depth, and the server estimates it.
        ///
        /// ARKit gives image, depth and `camera.transform` in the orientation of the sensor (landscape), however the
        /// phone is held. They match each other and are not rotated. `longest`: longest side of the image in pixels;
        /// larger images are scaled down. The server works at 320 x 240, and 640 keeps lamps sharp.
        public init(_ frame: ARFrame, index: Int? = nil, longest: Int = 640, quality: Double = 0.85) throws {
            let sceneDepth = frame.smoothedSceneDepth ?? frame.sceneDepth
            let (image, width, height) = try RoomLightFrame.jpeg(frame.capturedImage, longest: longest, quality: quality)
            let resolution = frame.camera.imageResolution
            let (scaleX, scaleY) = (Double(width) / Double(resolution.width), Double(height) / Double(resolution.height))
            let k = frame.camera.intrinsics // columns: (fx 0 0), (0 fy 0), (cx cy 1), at imageResolution
            let intrinsics = Intrinsics(
                fx: Double(k.columns.0.x) * scaleX, fy: Double(k.columns.1.y) * scaleY,
                cx: Double(k.columns.2.x) * scaleX, cy: Double(k.columns.2.y) * scaleY, width: width, height: height)
            let pose = frame.camera.transform
            let columns = [pose.columns.0, pose.columns.1, pose.columns.2, pose.columns.3]
            let depth = try (sceneDepth?.depthMap).map {
                try RoomLightFrame.plane($0, field: "depth", type: kCVPixelFormatType_DepthFloat32, pixelBytes: 4)
            }
            var confidence: Plane?
            if let map = sceneDepth?.confidenceMap {
                // ARConfidenceLevel: low 0, medium 1, high 2, as on the wire
                confidence = try RoomLightFrame.plane(
                    map, field: "confidence", type: kCVPixelFormatType_OneComponent8, pixelBytes: 1)
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
        /// and the session estimates it. (`exposureOffset` is the meter's distance from its target, not the
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
        static func plane(_ buffer: CVPixelBuffer, field: String, type: OSType, pixelBytes: Int) throws -> Plane {
            CVPixelBufferLockBaseAddress(buffer, .readOnly)
            defer { CVPixelBufferUnlockBaseAddress(buffer, .readOnly) }
            guard CVPixelBufferGetPixelFormatType(buffer) == type, let base = CVPixelBufferGetBaseAddress(buffer) else {
                throw RoomLightRefusal(field: field, rule: "must be a pixel buffer of type \(type)")
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
