// Generated from the server's OpenAPI document by `npm run generate`. Do not edit.
// Units: world metres (y up), seconds, milliseconds where a name says so. Light is linear RGB; 1.0 is the radiance that
// the session's reference exposure shows as white. docs/wire.md specifies the format.

export interface components {
    schemas: {
        /** @description The camera at a recorded frame; seconds since the first one. */
        readonly CameraPose: {
            readonly index: number;
            readonly seconds: number;
            readonly camera_to_world: readonly number[];
        };
        /**
         * @description The camera of the last processed frame, its path, and the lighting volume.
         *
         *     Attributes:
         *         frame: index of the last processed frame; -1 before the first.
         *         intrinsics: of the last processed frame.
         *         camera_to_world: of the last processed frame.
         *         exposure: of the last processed frame: radiance 1 / exposure is white in its picture; light has 1 as white.
         *         path: the frames of the history, in order.
         */
        readonly CameraView: {
            readonly frame: number;
            readonly intrinsics: components["schemas"]["WireIntrinsics"] | null;
            readonly camera_to_world: readonly number[] | null;
            readonly exposure: number | null;
            readonly path: readonly components["schemas"]["CameraPose"][];
            readonly volume: components["schemas"]["VolumeBox"] | null;
        };
        readonly ClientMessage: components["schemas"]["LightCall"] | components["schemas"]["Subscribe"] | components["schemas"]["Track"] | components["schemas"]["Untrack"];
        /**
         * @description The first part: the colour image, in sensor orientation (no EXIF rotation), of the size of the intrinsics.
         *
         *     Attributes:
         *         encoding: jpeg, png, heic: an 8-bit sRGB file; heic requires a server with the decoder. rgb8: 8-bit sRGB, row by
         *             row, 3 bytes per pixel. linear_f32: float32 linear RGB [h, w, 3], then uint8 [h, w], 1 where the sensor
         *             clipped, 2 or 3 where the pixel shows nothing (masked); lossless, for replays.
         *         bytes: length of the part.
         */
        readonly ColourPart: {
            readonly encoding: "jpeg" | "png" | "heic" | "rgb8" | "linear_f32";
            /** @description 1 to 2,147,483,648 */
            readonly bytes: number;
        };
        /**
         * @description A material that replaces those of a file.
         *
         *     Attributes:
         *         kind: diffuse, glossy, metal, mirror or glass.
         *         base_colour: default 0.8 grey, white for metal and glass; mirrors have none.
         *         roughness: 0 to 1, of glossy (0.2) and metal (0.5).
         */
        readonly CompositeMaterial: {
            readonly kind: "diffuse" | "glossy" | "metal" | "mirror" | "glass";
            readonly base_colour?: readonly [number, number, number] | null | undefined;
            /** @description 0 to 1 */
            readonly roughness?: number | null | undefined;
        };
        /**
         * @description An object and its place: exactly one of object and shape, and exactly one of position, pose and pixel.
         *
         *     Attributes:
         *         object: id of an uploaded object.
         *         shape: sphere, cube, plane, vase, chair or teapot, instead of an uploaded object.
         *         up: axis of an uploaded object that points up; z is turned to y.
         *         name: of the object in the answer; default object-0, object-1, ...
         *         size_m: longest side, up to 100 m; default: the file's own metres, 0.2 for sphere and cube, 0.3 for vase and
         *             teapot, 0.5 for plane, 0.85 for chair.
         *         material: `kind` (diffuse, glossy, metal, mirror or glass), `base_colour` and `roughness`; default: the file's
         *             own.
         *         position: world metres of the anchor, upright; with yaw_degrees.
         *         pose: rigid, object axes to world, 16 numbers column by column.
         *         pixel: column and row in the last processed frame, as it was sent: the object stands on the surface there.
         *         yaw_degrees: about the surface's normal, with position and pixel.
         *         anchor: point of the object that is placed: base (default), back, top, centre or origin. Not with pixel, whose
         *             surface chooses it.
         */
        readonly CompositeObject: {
            /** @description ^[0-9a-f]{64}$ */
            readonly object?: string | null | undefined;
            readonly shape?: ("sphere" | "cube" | "plane" | "vase" | "chair" | "teapot") | null | undefined;
            /** @default y */
            readonly up?: "y" | "z" | undefined;
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly name?: string | null | undefined;
            readonly size_m?: number | null | undefined;
            readonly material?: components["schemas"]["CompositeMaterial"] | null | undefined;
            readonly position?: components["schemas"]["Position"] | null | undefined;
            readonly pose?: readonly number[] | null | undefined;
            readonly pixel?: readonly number[] | null | undefined;
            /**
             * @description -3,600 to 3,600
             * @default 0
             */
            readonly yaw_degrees?: number | undefined;
            readonly anchor?: ("base" | "back" | "top" | "centre" | "origin") | null | undefined;
        };
        /**
         * @description Request for the last processed frame with objects in it; 1 to 16 objects.
         *
         *     Attributes:
         *         quality: preview, good or final.
         *         format: png and jpeg: 8-bit sRGB. exr: linear radiance. layers: a zip with the layers apart.
         */
        readonly CompositeRequest: {
            /** @description 1 to 16 items */
            readonly objects: readonly components["schemas"]["CompositeObject"][];
            /** @default preview */
            readonly quality?: "preview" | "good" | "final" | undefined;
            /** @default png */
            readonly format?: "png" | "jpeg" | "exr" | "layers" | undefined;
        };
        /**
         * @description The optional third part: one byte per depth pixel (0 low, 1 medium, 2 high), of the size of the depth map.
         *
         *     Attributes:
         *         format: uint8: 0 low, 1 medium, 2 high.
         *         encoding: raw, zstd or png (8-bit grey).
         *         width: that of the depth map.
         *         height: that of the depth map.
         *         bytes: length of the part.
         */
        readonly ConfidencePart: {
            /**
             * @default uint8
             * @constant
             */
            readonly format?: "uint8" | undefined;
            /** @default raw */
            readonly encoding?: "raw" | "png" | "zstd" | undefined;
            /** @description 1 to 16,384 */
            readonly width: number;
            /** @description 1 to 16,384 */
            readonly height: number;
            /** @description 1 to 2,147,483,648 */
            readonly bytes: number;
        };
        /**
         * @description The second part, optional: depth along the optical axis, row by row, little-endian, in the colour image's view.
         *
         *     Attributes:
         *         format: uint16_mm (0 and 65535 are unknown), float16_m or float32_m (unknown where not positive or above 100
         *             km).
         *         encoding: raw, zstd (one zstd frame of the raw values) or png (16-bit grey, uint16_mm only).
         *         width: pixels; the aspect is that of the image within 3 %.
         *         height: pixels.
         *         bytes: length of the part.
         *         estimated: whether a network made it, whose surfaces may lean.
         */
        readonly DepthPart: {
            readonly format: "uint16_mm" | "float16_m" | "float32_m";
            /** @default raw */
            readonly encoding?: "raw" | "png" | "zstd" | undefined;
            /** @description 1 to 16,384 */
            readonly width: number;
            /** @description 1 to 16,384 */
            readonly height: number;
            /** @description 1 to 2,147,483,648 */
            readonly bytes: number;
            /** @default null */
            readonly estimated?: boolean | null | undefined;
        };
        /**
         * @description The light of one probe in one form.
         *
         *     Attributes:
         *         values: the numbers of sh and main_light.
         *         data: the bytes of the other formats in base64, in plain JSON.
         *         bytes: the number of bytes of the other formats, in a binary light message.
         *         use: lighting or reflection; null: that of the format, see `LightForm`.
         */
        readonly EncodedLight: {
            readonly format: "exr" | "hdr" | "png" | "npy" | "cube" | "ktx2" | "specular" | "sh" | "main_light" | "confidence" | "equirect" | "usdz" | "glb";
            readonly media_type: string;
            readonly use?: ("lighting" | "reflection") | null | undefined;
            readonly values?: {
                readonly [key: string]: unknown;
            } | null;
            readonly data?: string | null | undefined;
            readonly bytes?: number | null | undefined;
        };
        /**
         * @description A film of a recording with objects in it.
         *
         *     Attributes:
         *         status: reading: the room, for its light; then making, ready; failed: see `problem`.
         *         frame: frames that are read, or made.
         *         frames: frames that will be.
         *         bytes: of the finished file.
         */
        readonly Film: {
            readonly status: "reading" | "making" | "ready" | "failed";
            readonly frame: number;
            readonly frames: number;
            readonly bytes: number;
            readonly problem: components["schemas"]["Problem"] | null;
        };
        /**
         * @description A film of a recording's own frames, up to 30 a second, with objects in it. The whole recording lights them.
         *
         *     Attributes:
         *         objects: with position or pose, in the world of the recording and of the sessions that it is played into.
         *         quality: preview, good or final.
         *         first: number of the first frame, of `film_frames`.
         *         frames: frames at most.
         */
        readonly FilmRequest: {
            /** @description 1 to 16 items */
            readonly objects: readonly components["schemas"]["CompositeObject"][];
            /** @default preview */
            readonly quality?: "preview" | "good" | "final" | undefined;
            /** @default 0 */
            readonly first?: number | undefined;
            /**
             * @description 1 to 300
             * @default 300
             */
            readonly frames?: number | undefined;
        };
        /**
         * @description Counts of a session's frames. accepted = processed + superseded + skipped + queued.
         *
         *     Attributes:
         *         gaps: indices that are missing between the first and the last accepted frame.
         *         durable_index: frames up to this index are on the server's disk and survive its restart; null: none are.
         */
        readonly FrameCounts: {
            readonly accepted: number;
            readonly processed: number;
            readonly superseded: number;
            readonly skipped: number;
            readonly queued: number;
            readonly gaps: number;
            readonly replayed: number;
            readonly refused: number;
            readonly last_index: number | null;
            readonly durable_index?: number | null | undefined;
        };
        /** @description WebSocket, to the client: the outcome of a frame. */
        readonly FrameEvent: {
            readonly index: number;
            readonly status: "processed" | "queued" | "superseded" | "skipped";
            /** @default false */
            readonly replay: boolean;
            /** @default null */
            readonly keyframe?: boolean | null | undefined;
            /** @default false */
            readonly depth_estimated: boolean;
            readonly stage_ms: {
                readonly [key: string]: number;
            };
            readonly coverage: {
                readonly [key: string]: number;
            };
            /** @default null */
            readonly gain?: readonly [number, number, number] | null | undefined;
            /** @default null */
            readonly durable_index?: number | null | undefined;
            /** @default null */
            readonly epoch?: number | null | undefined;
            /**
             * @default frame
             * @constant
             */
            readonly type: "frame";
        };
        /**
         * @description Everything about a frame except its pixels.
         *
         *     Attributes:
         *         version: 1.
         *         index: integer from 0, required on a WebSocket. Over HTTP the path has it; an index given here must equal it.
         *         colour: the colour image, below.
         *         depth: the depth map, below; null or left out: the frame has none, and the server estimates it.
         *         confidence: confidence of the depth, below; optional.
         *         intrinsics: fx, fy, cx, cy, width, height in pixels of the colour image.
         *         camera_to_world: 16 numbers, column by column, as `simd_float4x4` and WebGL store them: x axis, y axis, z axis,
         *             position, with fourth components 0, 0, 0, 1.
         *         timestamp_s: seconds from any origin; optional.
         *         exposure: exposure of the image in the unit of the session's reference exposure (for example shutter seconds x
         *             ISO); linear radiance is divided by exposure / reference exposure. Default 1.
         *         auto_exposed: whether the camera changes exposure and white balance and `exposure` does not say by how much: the
         *             session then estimates it from surfaces that frames share. Default: true for 8-bit images of exposure 1.
         *         tracking_state: normal (default), limited or not_available, as in ARKit. Frames that are not normal are counted
         *             and skipped; sessions with `use_limited_tracking` also use limited ones.
         */
        readonly FrameHeader: {
            /**
             * @default 1
             * @constant
             */
            readonly version?: 1 | undefined;
            /**
             * @description at least 0
             * @default null
             */
            readonly index?: number | null | undefined;
            readonly colour: components["schemas"]["ColourPart"];
            /** @default null */
            readonly depth?: components["schemas"]["DepthPart"] | null | undefined;
            /** @default null */
            readonly confidence?: components["schemas"]["ConfidencePart"] | null | undefined;
            readonly intrinsics: components["schemas"]["WireIntrinsics"];
            readonly camera_to_world: readonly number[];
            /** @default null */
            readonly timestamp_s?: number | null | undefined;
            /**
             * @description 1e-06 to 1,000,000
             * @default 1
             */
            readonly exposure?: number | undefined;
            /** @default null */
            readonly auto_exposed?: boolean | null | undefined;
            /** @default normal */
            readonly tracking_state?: "normal" | "limited" | "not_available" | undefined;
        };
        /**
         * @description Outcome of a frame.
         *
         *     Attributes:
         *         index: of the frame.
         *         status: processed: the light includes it. superseded: a newer frame replaced it in the queue. queued: accepted
         *             and waiting (only with `Prefer: respond-async`). skipped: not used because of its tracking state.
         *         replay: the same index and bytes were sent before; the frame was not processed again.
         *         keyframe: whether the frame was kept for probes that are requested later.
         *         depth_estimated: whether the server estimated the frame's depth.
         *         stage_ms: processing time of each stage.
         *         coverage: coverage of each named probe after the last processed frame.
         *         gain: factors of red, green and blue by which the frame's radiance becomes that of the light.
         *         durable_index: frames up to this index are on the server's disk and survive its restart; null: none are.
         *         epoch: number of the server that answered among all servers that have owned the session, from 1; null: servers
         *             share no state directory. It never decreases.
         */
        readonly FrameResult: {
            readonly index: number;
            readonly status: "processed" | "queued" | "superseded" | "skipped";
            /** @default false */
            readonly replay: boolean;
            readonly keyframe?: boolean | null | undefined;
            /** @default false */
            readonly depth_estimated: boolean;
            readonly stage_ms: {
                readonly [key: string]: number;
            };
            readonly coverage: {
                readonly [key: string]: number;
            };
            readonly gain?: readonly [number, number, number] | null | undefined;
            readonly durable_index?: number | null | undefined;
            readonly epoch?: number | null | undefined;
        };
        /**
         * @description A recorded frame.
         *
         *     Attributes:
         *         seconds: when it was processed, since the first recorded frame.
         *         timestamp_s: the frame's own time.
         *         superseded: frames replaced by newer ones so far.
         *         gaps: indices left out by the client so far.
         *         skipped: frames skipped for their tracking state so far.
         *         refused: frames refused so far.
         */
        readonly HistoryEntry: {
            readonly index: number;
            readonly seconds: number;
            readonly timestamp_s: number | null;
            readonly keyframe: boolean;
            readonly stage_ms: {
                readonly [key: string]: number;
            };
            readonly superseded: number;
            readonly gaps: number;
            readonly skipped: number;
            readonly refused: number;
            readonly probes: readonly components["schemas"]["HistoryProbe"][];
        };
        /** @description A light at a probe, with the fields of the form `main_light`, as strong as in the session's own estimate. */
        readonly HistoryLight: {
            readonly direction: readonly number[];
            readonly intensity: readonly number[];
            readonly radius_deg: number;
            readonly shadow_strength: number;
            readonly emitted: number;
            readonly number: number;
        };
        /**
         * @description The recorded frames of a session.
         *
         *     Attributes:
         *         stride: every `stride`-th processed frame is recorded. It doubles when the history is full, and then every
         *             second entry is removed.
         *         bytes: memory of the history.
         *         limit_bytes: its limit; 0: no history is kept.
         */
        readonly HistoryList: {
            readonly stride: number;
            readonly bytes: number;
            readonly limit_bytes: number;
            readonly entries: readonly components["schemas"]["HistoryEntry"][];
        };
        /** @description A named probe after a recorded frame; `lights` has up to three, the strongest first. */
        readonly HistoryProbe: {
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly name: string;
            readonly position: components["schemas"]["Position"];
            readonly coverage: number;
            readonly lights: readonly components["schemas"]["HistoryLight"][];
        };
        /** @description WebSocket, to the client: the answer to a `light` message. */
        readonly LightAnswer: {
            readonly frame: number;
            readonly results: readonly components["schemas"]["ProbeLight"][];
            /**
             * @default light
             * @constant
             */
            readonly type: "light";
            readonly request: string;
        };
        /** @description WebSocket, to the server: request light now. The answer carries the same `request`. */
        readonly LightCall: {
            /** @description 1 to 64 items */
            readonly probes: readonly components["schemas"]["ProbeQuery"][];
            /** @description 1 to 20 items */
            readonly forms: readonly components["schemas"]["LightForm"][];
            /** @constant */
            readonly type: "light";
            /** @default  */
            readonly request?: string | undefined;
        };
        /**
         * @description An output encoding of light: a format and its parameters.
         *
         *     Attributes:
         *         format: name of the encoding.
         *         size: panorama height of exr, hdr, png, npy, equirect, usdz and confidence, 8 to 512 (default: as computed);
         *             face width of cube, ktx2, specular and glb, 16, 32, 64, 128 or 256 (default 32).
         *         kind: for sh: total, or ambient (without the main light).
         *         basis: for sh: arcore (27 interleaved, Condon-Shortley phase, for code with -0.325735 at C1-1), arkit (27
         *             planar, the same phase: Apple documents 27 non-interleaved numbers without signs, these are RoomLight's),
         *             threejs (27 interleaved, all signs positive; also for ARCore's SDK for Unity).
         *         exposure_ev: for png: radiance 2^-exposure_ev is white.
         *         use: lighting, what lights a thing, or reflection, what is seen in a mirror and behind things; default:
         *             reflection for png, lighting for all others.
         */
        readonly LightForm: {
            readonly format: "exr" | "hdr" | "png" | "npy" | "cube" | "ktx2" | "specular" | "sh" | "main_light" | "confidence" | "equirect" | "usdz" | "glb";
            /** @description 8 to 512 */
            readonly size?: number | null | undefined;
            /** @default total */
            readonly kind?: "total" | "ambient" | undefined;
            /** @default arcore */
            readonly basis?: "arcore" | "arkit" | "threejs" | undefined;
            /**
             * @description -16 to 16
             * @default 0
             */
            readonly exposure_ev?: number | undefined;
            readonly use?: ("lighting" | "reflection") | null | undefined;
        };
        /** @description Request for light at several points after the same frame, each in every form; 1 to 64 probes, 1 to 20 forms. */
        readonly LightRequest: {
            /** @description 1 to 64 items */
            readonly probes: readonly components["schemas"]["ProbeQuery"][];
            /** @description 1 to 20 items */
            readonly forms: readonly components["schemas"]["LightForm"][];
        };
        /**
         * @description Light at several points, in the order of the request.
         *
         *     Attributes:
         *         frame: index of the last processed frame; -1 before the first frame: the light is then the default light, grey,
         *             brighter from above, with zero coverage.
         */
        readonly LightResponse: {
            readonly frame: number;
            readonly results: readonly components["schemas"]["ProbeLight"][];
        };
        /** @description WebSocket, to the client: the light of the named probes after a frame, for a subscription. */
        readonly LightingUpdate: {
            readonly frame: number;
            readonly results: readonly components["schemas"]["ProbeLight"][];
            /**
             * @default lighting
             * @constant
             */
            readonly type: "lighting";
        };
        /** @description Memory of a session: bytes now, and the upper bound with its options. */
        readonly Memory: {
            readonly bytes: number;
            readonly bound_bytes: number;
        };
        /**
         * @description An object that the server holds.
         *
         *     Attributes:
         *         id: SHA-256 of the file, hexadecimal.
         *         triangles: number of triangles.
         *         lower_m: lower corner of its bounding box about its origin, in the file's own metres.
         *         size_m: sides of its bounding box in the file's own metres.
         *         bytes: memory that it takes on the server.
         *         notes: what its file states and was left out or changed.
         */
        readonly ObjectInfo: {
            /** @description ^[0-9a-f]{64}$ */
            readonly id: string;
            readonly triangles: number;
            readonly lower_m: readonly [number, number, number];
            readonly size_m: readonly [number, number, number];
            readonly bytes: number;
            /** @default [] */
            readonly notes: readonly string[];
        };
        /** @description The objects of a token, the memory that they take together, and its limit. */
        readonly ObjectList: {
            readonly objects: readonly components["schemas"]["ObjectInfo"][];
            readonly bytes: number;
            readonly limit_bytes: number;
        };
        /** @description A paired phone, and the ids of its open sessions. */
        readonly PairedPhone: {
            readonly id: string;
            readonly age_s: number;
            readonly expires_in_s: number;
            readonly sessions: readonly string[];
        };
        /**
         * @description How a phone on the local network reaches the server's page.
         *
         *     Attributes:
         *         url: address of the phone's page, where the server has tokens with a code that pairs one phone; null if the
         *             server cannot be reached.
         *         qr_svg: the address as a QR code, an SVG document.
         *         fingerprint: SHA-256 of the server's certificate.
         *         expires_in_s: time in which the code can be used; null without a code.
         *         advice: what to do where there is no address.
         */
        readonly Pairing: {
            readonly url: string | null;
            readonly qr_svg: string | null;
            readonly fingerprint: string | null;
            readonly expires_in_s: number | null;
            readonly advice: string | null;
        };
        /** @description The code of a link, which works once. */
        readonly PairingCode: {
            readonly code: string;
        };
        /** @description The phones that a token has paired. */
        readonly PhoneList: {
            readonly phones: readonly components["schemas"]["PairedPhone"][];
        };
        /** @description The token of a phone that has been paired, and its id. */
        readonly PhoneToken: {
            readonly id: string;
            readonly token: string;
            readonly expires_in_s: number;
        };
        /** @description World metres: x, y (up), z. */
        readonly Position: readonly [number, number, number];
        /** @description Position of a named probe, in world metres. */
        readonly ProbeBody: {
            readonly position: components["schemas"]["Position"];
        };
        /**
         * @description The light at one point.
         *
         *     Attributes:
         *         coverage: fraction of the sphere that was observed, by solid angle, 0 to 1.
         *         etag: identifies the light: equal etags mean equal light.
         */
        readonly ProbeLight: {
            readonly position: components["schemas"]["Position"];
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly name?: string | null | undefined;
            readonly coverage: number;
            readonly etag: string;
            readonly forms: readonly components["schemas"]["EncodedLight"][];
        };
        /** @description A point: either a position in world metres or the name of a tracked probe. */
        readonly ProbeQuery: {
            readonly position?: components["schemas"]["Position"] | null | undefined;
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly name?: string | null | undefined;
        };
        /** @description WebSocket, to the client: the named probes, after `track` or `untrack`. */
        readonly ProbesEvent: {
            /**
             * @default probes
             * @constant
             */
            readonly type: "probes";
            readonly probes: {
                readonly [key: string]: components["schemas"]["Position"];
            };
        };
        /** @description Problem details (RFC 9457) of a rejected request: the field, the value received and the rule that it breaks. */
        readonly Problem: {
            readonly type: string;
            readonly title: string;
            readonly status: number;
            readonly detail: string;
            readonly field?: string | null | undefined;
            readonly value?: string | null | undefined;
            readonly rule?: string | null | undefined;
        };
        /**
         * @description WebSocket, to the client: a message was rejected or failed; the connection stays open.
         *
         *     Attributes:
         *         index: index of the frame concerned, if its header could be read.
         *         request: `request` of the `light` message concerned.
         */
        readonly ProblemEvent: {
            /**
             * @default problem
             * @constant
             */
            readonly type: "problem";
            readonly problem: components["schemas"]["Problem"];
            /** @default null */
            readonly index?: number | null | undefined;
            /** @default null */
            readonly request?: string | null | undefined;
        };
        /**
         * @description An uploaded recording and its replay.
         *
         *     Attributes:
         *         bytes: announced.
         *         received: bytes so far.
         *         files: announced.
         *         files_received: files that have begun.
         *         status: uploading, then ready, playing, finished; failed: it cannot be read, see `problem`.
         *         session: the session that it is played into.
         *         frame: frames sent to the session so far.
         *         frames: frames of the recording that are played; null before the first replay.
         *         unreadable: frames that could not be read or used so far.
         *         notes: what its files state and was left out, guessed or changed, and what to do about it.
         *         film_frames: frames that a film of it can have, and film_fps: their rate; null before the first replay.
         *         film: the film that was asked for last; null: none.
         *         expires_in_s: it is deleted after this time without a request.
         */
        readonly Recording: {
            /** @description ^r-[0-9a-f]{16}$ */
            readonly id: string;
            readonly name: string;
            readonly bytes: number;
            readonly received: number;
            readonly files: number;
            readonly files_received: number;
            readonly status: "uploading" | "ready" | "playing" | "finished" | "failed";
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly session: string | null;
            readonly frame: number;
            readonly frames: number | null;
            readonly unreadable: number;
            readonly notes: readonly string[];
            readonly film_frames: number | null;
            readonly film_fps: number | null;
            readonly film: components["schemas"]["Film"] | null;
            readonly problem: components["schemas"]["Problem"] | null;
            readonly expires_in_s: number;
        };
        /** @description The recordings of a token, the newest first, the bytes that they take or announced, and their limit. */
        readonly RecordingList: {
            readonly recordings: readonly components["schemas"]["Recording"][];
            readonly bytes: number;
            readonly limit_bytes: number;
        };
        /**
         * @description Announcement of an upload.
         *
         *     Attributes:
         *         name: shown in lists, for example the name of the folder.
         *         bytes: of all files together.
         *         files: number of files.
         */
        readonly RecordingRequest: {
            readonly name: string;
            readonly bytes: number;
            readonly files: number;
        };
        /**
         * @description Start of a replay into a new session, at the pace of the recording.
         *
         *     Attributes:
         *         session: id of the session, which has no frame yet.
         *         model: the session's model.
         *         height: rows of the session's panoramas.
         *         fps: frames per second at most: every n-th frame is played. Null: 10 of a recording with timestamps, 3 of one
         *             without.
         *         probes: named probes; null: the probes of the recording, and `view` in front of the first camera.
         */
        readonly ReplayRequest: {
            /** @default auto */
            readonly model?: "auto" | "classical" | "single" | "video" | undefined;
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly session: string;
            /**
             * @description 16 to 512
             * @default 120
             */
            readonly height?: number | undefined;
            /** @description 0.01 to 60 */
            readonly fps?: number | null | undefined;
            readonly probes?: {
                readonly [key: string]: components["schemas"]["Position"];
            } | null;
        };
        readonly ServerMessage: components["schemas"]["FrameEvent"] | components["schemas"]["LightAnswer"] | components["schemas"]["LightingUpdate"] | components["schemas"]["ProbesEvent"] | components["schemas"]["ProblemEvent"];
        /** @description The sessions of a token, last used first, and its limits. */
        readonly SessionList: {
            readonly sessions: readonly components["schemas"]["SessionSummary"][];
            readonly max_sessions: number;
            readonly idle_expiry_s: number;
        };
        /**
         * @description Options of a session.
         *
         *     Attributes:
         *         model: which model estimates the light: auto (default: the server's), classical, single or video.
         *         height: height of the panoramas in pixels, 16 to 512, default 120; the width is twice the height.
         *         reference_exposure: the exposure at which radiance 1.0 is white, in the unit of the frames' exposure, 1e-6 to
         *             1e6; null: the exposure of the first frame.
         *         use_limited_tracking: also use frames whose tracking state is `limited`. Off by default, because their poses can
         *             be wrong and errors in the room's light persist.
         *         min_confidence: depth pixels below this confidence (0, 1 or 2; default 1) are unknown.
         *         unknown_depth: pixels of unknown depth take depth interpolated from the rim of their hole (`rim`, the default),
         *             lie on the far boundary of the volume (`far`), or are not used (`drop`).
         */
        readonly SessionRequest: {
            /** @default auto */
            readonly model?: "auto" | "classical" | "single" | "video" | undefined;
            /**
             * @description 16 to 512
             * @default 120
             */
            readonly height?: number | undefined;
            /** @description 1e-06 to 1,000,000 */
            readonly reference_exposure?: number | null | undefined;
            /** @default false */
            readonly use_limited_tracking?: boolean | undefined;
            /**
             * @description 0 to 2
             * @default 1
             */
            readonly min_confidence?: number | undefined;
            /** @default rim */
            readonly unknown_depth?: "rim" | "far" | "drop" | undefined;
        };
        /**
         * @description What people keep with a session: its title, and the objects that its viewers see in it; at most 16.
         *
         *     Attributes:
         *         title: shown in place of the id; empty: the id.
         *         objects: with position or pose. A pixel belongs to one frame: send the pose of the composite's answer instead.
         */
        readonly SessionScene: {
            /**
             * @description ^[^\x00-\x1f\x7f]*$
             * @default
             */
            readonly title?: string | undefined;
            /** @description 0 to 16 items */
            readonly objects?: readonly components["schemas"]["CompositeObject"][] | undefined;
        };
        /** @description State of a session. After an engine error its status is `failed`: delete it and open a new one. */
        readonly SessionState: {
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly id: string;
            readonly status: "open" | "failed";
            readonly model: "classical" | "single" | "video";
            readonly options: components["schemas"]["SessionRequest"];
            readonly frames: components["schemas"]["FrameCounts"];
            readonly probes: {
                readonly [key: string]: components["schemas"]["Position"];
            };
            readonly coverage: {
                readonly [key: string]: number;
            };
            readonly keyframes: number;
            readonly memory: components["schemas"]["Memory"];
            readonly volume: components["schemas"]["Volume"] | null;
            readonly idle_expiry_s: number;
        };
        /**
         * @description A session in the list of a token's sessions.
         *
         *     Attributes:
         *         title: as its viewers have named it; empty: they have not.
         *         status: `saved` is on disk and not in memory; its next request restores it.
         *         probes: names of the tracked probes.
         *         idle_s: seconds since its last request; 0 while a request or a WebSocket uses it.
         */
        readonly SessionSummary: {
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly id: string;
            /** @default  */
            readonly title: string;
            readonly status: "open" | "failed" | "saved";
            readonly model: "classical" | "single" | "video";
            readonly frames: components["schemas"]["FrameCounts"];
            readonly probes: readonly string[];
            readonly keyframes: number;
            readonly idle_s: number;
        };
        /**
         * @description WebSocket, to the server: send the light of all named probes in these forms now and after each frame.
         *
         *     An empty list ends the subscription.
         */
        readonly Subscribe: {
            /** @constant */
            readonly type: "subscribe";
            /** @description 0 to 20 items */
            readonly forms: readonly components["schemas"]["LightForm"][];
        };
        /** @description WebSocket, to the server: track a named probe; an existing name moves to the new position. */
        readonly Track: {
            /** @constant */
            readonly type: "track";
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly name: string;
            readonly position: components["schemas"]["Position"];
        };
        /** @description WebSocket, to the server: stop tracking a named probe. */
        readonly Untrack: {
            /** @constant */
            readonly type: "untrack";
            /** @description ^[A-Za-z0-9_-]{1,64}$ */
            readonly name: string;
        };
        /** @description The lighting volume: a box of `shape` (z, y, x) voxels with edges of `voxel_m` metres. */
        readonly Volume: {
            readonly shape: readonly number[];
            readonly voxel_m: number;
            readonly depth_max_m: number;
        };
        /** @description The box of the lighting volume: corners (x, y, z) in metres along its own axes. */
        readonly VolumeBox: {
            readonly volume_to_world: readonly number[];
            readonly lower_m: components["schemas"]["Position"];
            readonly upper_m: components["schemas"]["Position"];
        };
        /** @description A pinhole camera in pixels of the colour image. Pixel centres are at half integers. */
        readonly WireIntrinsics: {
            readonly fx: number;
            readonly fy: number;
            readonly cx: number;
            readonly cy: number;
            /** @description 1 to 16,384 */
            readonly width: number;
            /** @description 1 to 16,384 */
            readonly height: number;
        };
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type CameraPose = components['schemas']['CameraPose'];
export type CameraView = components['schemas']['CameraView'];
export type ClientMessage = components['schemas']['ClientMessage'];
export type ColourPart = components['schemas']['ColourPart'];
export type CompositeMaterial = components['schemas']['CompositeMaterial'];
export type CompositeObject = components['schemas']['CompositeObject'];
export type CompositeRequest = components['schemas']['CompositeRequest'];
export type ConfidencePart = components['schemas']['ConfidencePart'];
export type DepthPart = components['schemas']['DepthPart'];
export type EncodedLight = components['schemas']['EncodedLight'];
export type Film = components['schemas']['Film'];
export type FilmRequest = components['schemas']['FilmRequest'];
export type FrameCounts = components['schemas']['FrameCounts'];
export type FrameEvent = components['schemas']['FrameEvent'];
export type FrameHeader = components['schemas']['FrameHeader'];
export type FrameResult = components['schemas']['FrameResult'];
export type HistoryEntry = components['schemas']['HistoryEntry'];
export type HistoryLight = components['schemas']['HistoryLight'];
export type HistoryList = components['schemas']['HistoryList'];
export type HistoryProbe = components['schemas']['HistoryProbe'];
export type LightAnswer = components['schemas']['LightAnswer'];
export type LightCall = components['schemas']['LightCall'];
export type LightForm = components['schemas']['LightForm'];
export type LightRequest = components['schemas']['LightRequest'];
export type LightResponse = components['schemas']['LightResponse'];
export type LightingUpdate = components['schemas']['LightingUpdate'];
export type Memory = components['schemas']['Memory'];
export type ObjectInfo = components['schemas']['ObjectInfo'];
export type ObjectList = components['schemas']['ObjectList'];
export type PairedPhone = components['schemas']['PairedPhone'];
export type Pairing = components['schemas']['Pairing'];
export type PairingCode = components['schemas']['PairingCode'];
export type PhoneList = components['schemas']['PhoneList'];
export type PhoneToken = components['schemas']['PhoneToken'];
export type Position = components['schemas']['Position'];
export type ProbeBody = components['schemas']['ProbeBody'];
export type ProbeLight = components['schemas']['ProbeLight'];
export type ProbeQuery = components['schemas']['ProbeQuery'];
export type ProbesEvent = components['schemas']['ProbesEvent'];
export type Problem = components['schemas']['Problem'];
export type ProblemEvent = components['schemas']['ProblemEvent'];
export type Recording = components['schemas']['Recording'];
export type RecordingList = components['schemas']['RecordingList'];
export type RecordingRequest = components['schemas']['RecordingRequest'];
export type ReplayRequest = components['schemas']['ReplayRequest'];
export type ServerMessage = components['schemas']['ServerMessage'];
export type SessionList = components['schemas']['SessionList'];
export type SessionRequest = components['schemas']['SessionRequest'];
export type SessionScene = components['schemas']['SessionScene'];
export type SessionState = components['schemas']['SessionState'];
export type SessionSummary = components['schemas']['SessionSummary'];
export type Subscribe = components['schemas']['Subscribe'];
export type Track = components['schemas']['Track'];
export type Untrack = components['schemas']['Untrack'];
export type Volume = components['schemas']['Volume'];
export type VolumeBox = components['schemas']['VolumeBox'];
export type WireIntrinsics = components['schemas']['WireIntrinsics'];
