// Made by python -m roomlight_client.wire_types from the server's own models: do not edit.
// Units: world metres (y up), seconds, milliseconds where a name says so; light is linear RGB, 1.0 = what the session's
// reference exposure shows as white. server/WIRE.md tells the whole format.

export const FRAME_MAGIC = "RLF1";
export const LIGHT_MAGIC = "RLL1";
export const LIGHT_MEDIA_TYPE = "application/vnd.roomlight.light";
export const VERSION = 1;
export const MAX_HEADER_BYTES = 16384;
export const MAX_PROBES = 64;
export const MAX_FORMS = 16;
/** Bytes of one depth value, little-endian. */
export const DEPTH_BYTES = { uint16_mm: 2, float16_m: 2, float32_m: 4 } as const;

export type ColourEncoding = "jpeg" | "png" | "heic" | "rgb8" | "linear_f32";

export type DepthFormat = "uint16_mm" | "float16_m" | "float32_m";

export type PlaneEncoding = "raw" | "png" | "zstd";

export type TrackingState = "normal" | "limited" | "not_available";

export type ModelName = "auto" | "classical" | "single" | "video";

export type LightFormat = "exr" | "hdr" | "png" | "npy" | "cube" | "ktx2" | "specular" | "sh" | "main_light" | "confidence";

export type HarmonicsKind = "total" | "ambient";

export type HarmonicsBasis = "arcore" | "arkit" | "threejs";

export type FrameStatus = "processed" | "queued" | "superseded" | "skipped";

/** World metres: x, y (up), z. */
export type Position = readonly [number, number, number];

/**
 * The first part: the colour image, in sensor orientation (no EXIF rotation), of the size of the intrinsics.
 *
 * jpeg, png, heic: an 8-bit sRGB file.
 * rgb8:            8-bit sRGB, row by row, 3 bytes per pixel.
 * linear_f32:      float32 linear RGB [h, w, 3], then uint8 [h, w], 1 where the sensor clipped; lossless, for replays.
 */
export interface ColourPart {
  encoding: ColourEncoding;
  bytes: number; // 1 to 2,147,483,648
}

/** The optional third part: one byte per depth pixel (0 low, 1 medium, 2 high), of the size of the depth map. */
export interface ConfidencePart {
  format?: "uint8";
  encoding?: PlaneEncoding; // default "raw"
  width: number; // 1 to 16,384
  height: number; // 1 to 16,384
  bytes: number; // 1 to 2,147,483,648
}

/**
 * The second part: depth along the optical axis, row by row, little-endian, in the view of the colour image.
 *
 * Unknown depth is 0 or 65535 in millimetres; in metres, any value that is not finite and positive.
 */
export interface DepthPart {
  format: DepthFormat;
  encoding?: PlaneEncoding; // default "raw"
  width: number; // 1 to 16,384
  height: number; // 1 to 16,384
  bytes: number; // 1 to 2,147,483,648
}

/**
 * The light of one probe in one form.
 *
 * values: the numbers of sh and main_light.
 * data:   the bytes of the other formats in base64, in plain JSON.
 * bytes:  the number of bytes of the other formats, in a binary light message.
 */
export interface EncodedLight {
  format: LightFormat;
  media_type: string;
  values?: { readonly [name: string]: unknown } | null;
  data?: string | null;
  bytes?: number | null;
}

/**
 * Counts of a session's frames. accepted = processed + superseded + skipped + queued.
 *
 * gaps: indices that are missing between the first and the last accepted frame.
 */
export interface FrameCounts {
  accepted: number;
  processed: number;
  superseded: number;
  skipped: number;
  queued: number;
  gaps: number;
  replayed: number;
  refused: number;
  last_index: number | null;
}

/** WebSocket, to the client: the outcome of a frame. */
export interface FrameEvent {
  index: number;
  status: FrameStatus;
  replay: boolean;
  keyframe?: boolean | null;
  stage_ms: { readonly [name: string]: number };
  coverage: { readonly [name: string]: number };
  type: "frame";
}

/**
 * Everything about a frame except its pixels.
 *
 * index:            required on a WebSocket. Over HTTP the path has it; an index given here must equal it.
 * camera_to_world:  16 numbers, column by column, as `simd_float4x4` is stored: x axis, y axis, z axis, position.
 * exposure:         exposure of the image in the unit of the session's reference exposure (for example shutter
 *                   seconds x ISO); linear radiance is divided by exposure / reference exposure.
 * tracking_state:   ARKit's tracking state. Only `normal` frames are used, unless the session allows `limited` ones.
 */
export interface FrameHeader {
  version?: 1;
  index?: number | null; // from 0
  colour: ColourPart;
  depth: DepthPart;
  confidence?: ConfidencePart | null;
  intrinsics: WireIntrinsics;
  camera_to_world: readonly number[]; // 16 of them
  timestamp_s?: number | null;
  exposure?: number; // 1e-06 to 1,000,000; default 1.0
  tracking_state?: TrackingState; // default "normal"
}

/**
 * Outcome of a frame.
 *
 * status:   processed: the light includes it. superseded: a newer frame replaced it in the queue. queued: accepted and
 *           waiting (only with `Prefer: respond-async`). skipped: not used because of its tracking state.
 * replay:   the same index and bytes were sent before; the frame was not processed again.
 * keyframe: whether the frame was kept for probes that are requested later.
 * stage_ms: processing time of each stage.
 * coverage: coverage of each named probe after the last processed frame.
 */
export interface FrameResult {
  index: number;
  status: FrameStatus;
  replay: boolean;
  keyframe?: boolean | null;
  stage_ms: { readonly [name: string]: number };
  coverage: { readonly [name: string]: number };
}

/** WebSocket, to the client: the answer to a `light` message. */
export interface LightAnswer {
  frame: number;
  results: readonly ProbeLight[];
  type: "light";
  request: string;
}

/** WebSocket, to the server: request light now. The answer carries the same `request`. */
export interface LightCall {
  probes: readonly ProbeQuery[]; // 1 to 64 of them
  forms: readonly LightForm[]; // 1 to 16 of them
  type: "light";
  request?: string; // default ""
}

/**
 * An output encoding of light: a format and its parameters.
 *
 * size:         panorama height of exr, hdr, png, npy and confidence, 8 to 512 (default: as computed); face width of
 *               cube, ktx2 and specular, 16, 32, 64, 128 or 256 (default 32).
 * kind:         for sh: total, or ambient (without the main light).
 * basis:        for sh: arcore (27 interleaved, Condon-Shortley phase; also WebXR), arkit (27 planar, Condon-Shortley
 *               phase), threejs (27 interleaved, all signs positive).
 * exposure_ev:  for png: radiance 2^-exposure_ev is white.
 */
export interface LightForm {
  format: LightFormat;
  size?: number | null; // 8 to 512
  kind?: HarmonicsKind; // default "total"
  basis?: HarmonicsBasis; // default "arcore"
  exposure_ev?: number; // -16 to 16; default 0.0
}

/** Request for light at several points after the same frame, each in every form; 1 to 64 probes, 1 to 16 forms. */
export interface LightRequest {
  probes: readonly ProbeQuery[]; // 1 to 64 of them
  forms: readonly LightForm[]; // 1 to 16 of them
}

/**
 * Light at several points, in the order of the request.
 *
 * frame: index of the last processed frame; -1 before the first frame: the light is then the default light, grey,
 *        brighter from above, with zero coverage.
 */
export interface LightResponse {
  frame: number;
  results: readonly ProbeLight[];
}

/** WebSocket, to the client: the light of the named probes after a frame, for a subscription. */
export interface LightingUpdate {
  frame: number;
  results: readonly ProbeLight[];
  type: "lighting";
}

/** Memory of a session: bytes now, and the upper bound with its options. */
export interface Memory {
  bytes: number;
  bound_bytes: number;
}

/** Position of a named probe, in world metres. */
export interface ProbeBody {
  position: Position;
}

/**
 * The light at one point.
 *
 * coverage: fraction of the sphere that was observed, by solid angle, 0 to 1.
 * etag:     identifies the light: equal etags mean equal light.
 */
export interface ProbeLight {
  position: Position;
  name?: string | null;
  coverage: number;
  etag: string;
  forms: readonly EncodedLight[];
}

/** A point: either a position in world metres or the name of a tracked probe. */
export interface ProbeQuery {
  position?: Position | null;
  name?: string | null; // ^[A-Za-z0-9_-]{1,64}$
}

/** WebSocket, to the client: the named probes, after `track` or `untrack`. */
export interface ProbesEvent {
  type: "probes";
  probes: { readonly [name: string]: Position };
}

/** Problem details (RFC 9457) of a rejected request: the field, the value received and the rule that it breaks. */
export interface Problem {
  type: string;
  title: string;
  status: number;
  detail: string;
  field?: string | null;
  value?: string | null;
  rule?: string | null;
}

/**
 * WebSocket, to the client: a message was rejected or failed; the connection stays open.
 *
 * index:   index of the frame concerned, if its header could be read.
 * request: `request` of the `light` message concerned.
 */
export interface ProblemEvent {
  type: "problem";
  problem: Problem;
  index?: number | null;
  request?: string | null;
}

/**
 * Options of a session.
 *
 * mode:                which model estimates the light; `auto` is the server's default.
 * height:              height of the panoramas in pixels; the width is twice the height.
 * reference_exposure:  the exposure at which radiance 1.0 is white, in the unit of the frames' exposure; null: the
 *                      exposure of the first frame.
 * use_limited_tracking: also use frames whose tracking state is `limited`. Off by default, because their poses can be
 *                      wrong and errors in the room's light persist.
 * min_confidence:      depth pixels below this confidence (0, 1 or 2) are unknown.
 * unknown_depth:       pixels of unknown depth take depth interpolated from the rim of their hole (`rim`), lie on the
 *                      far boundary of the volume (`far`), or are not used (`drop`).
 */
export interface SessionRequest {
  mode?: ModelName; // default "auto"
  height?: number; // 16 to 512; default 120
  reference_exposure?: number | null; // 1e-06 to 1,000,000
  use_limited_tracking?: boolean; // default false
  min_confidence?: number; // 0 to 2; default 1
  unknown_depth?: "rim" | "far" | "drop"; // default "rim"
}

/** State of a session. After an engine error its status is `failed`: delete it and open a new one. */
export interface SessionState {
  id: string;
  status: "open" | "failed";
  model: "classical" | "single" | "video";
  options: SessionRequest;
  frames: FrameCounts;
  probes: { readonly [name: string]: Position };
  coverage: { readonly [name: string]: number };
  keyframes: number;
  memory: Memory;
  volume: Volume | null;
  idle_expiry_s: number;
}

/**
 * WebSocket, to the server: send the light of all named probes in these forms now and after each frame.
 *
 * An empty list ends the subscription.
 */
export interface Subscribe {
  type: "subscribe";
  forms: readonly LightForm[]; // 0 to 16 of them
}

/** WebSocket, to the server: track a named probe; an existing name moves to the new position. */
export interface Track {
  type: "track";
  name: string; // ^[A-Za-z0-9_-]{1,64}$
  position: Position;
}

/** WebSocket, to the server: stop tracking a named probe. */
export interface Untrack {
  type: "untrack";
  name: string; // ^[A-Za-z0-9_-]{1,64}$
}

/** The lighting volume: a box of `shape` (z, y, x) voxels with edges of `voxel_m` metres. */
export interface Volume {
  shape: readonly number[];
  voxel_m: number;
  depth_max_m: number;
}

/** A pinhole camera in pixels of the colour image. Pixel centres are at half integers. */
export interface WireIntrinsics {
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number; // 1 to 16,384
  height: number; // 1 to 16,384
}

export type ClientMessage = LightCall | Subscribe | Track | Untrack;

export type ServerMessage = FrameEvent | LightAnswer | LightingUpdate | ProbesEvent | ProblemEvent;
