// Made by python -m roomlight_client.wire_types from the server's own models: do not edit.
// Units: world metres (y up), seconds, milliseconds where a name says so; light is linear RGB, 1.0 = what the session's
// reference exposure shows as white. server/WIRE.md tells the whole format.

export const FRAME_MAGIC = "RLF1";
export const LIGHT_MAGIC = "RLL1";
export const LIGHT_MEDIA_TYPE = "application/vnd.roomlight.light";
export const VERSION = 1;
export const MAX_HEADER_BYTES = 16384;
export const MAX_PROBES = 64;
export const MAX_FORMS = 8;
/** Bytes of one depth value, little-endian. */
export const DEPTH_BYTES = { uint16_mm: 2, float16_m: 2, float32_m: 4 } as const;

export type ColourEncoding = "jpeg" | "png" | "heic" | "rgb8" | "linear_f32";

export type DepthFormat = "uint16_mm" | "float16_m" | "float32_m";

export type PlaneEncoding = "raw" | "png" | "zstd";

export type TrackingState = "normal" | "limited" | "not_available";

export type ModelName = "auto" | "classical" | "single" | "video";

export type LightFormat = "exr" | "hdr" | "png" | "npy" | "cube" | "ktx2" | "specular" | "sh" | "main_light" | "confidence";

export type Kind = "total" | "ambient";

export type Basis = "arcore" | "arkit" | "threejs";

export type FrameStatus = "processed" | "queued" | "superseded" | "skipped";

/** World metres: x, y (up), z. */
export type Position = readonly [number, number, number];

/**
 * The first part. Its size in pixels is the intrinsics'; pixels stand as the sensor gave them, with no EXIF turn.
 *
 * jpeg, png, heic: 8-bit sRGB. rgb8: 8-bit sRGB, row by row, 3 bytes a pixel. linear_f32: float32 linear RGB
 * [h, w, 3], then uint8 [h, w], 1 where the sensor clipped: for replays that must not lose a bit.
 */
export interface ColourPart {
  encoding: ColourEncoding;
  bytes: number; // 1 to 2,147,483,648
}

/** The optional third part: one byte a depth pixel, 0 low, 1 medium, 2 high, of the depth's size. */
export interface ConfidencePart {
  format?: "uint8";
  encoding?: PlaneEncoding; // default "raw"
  width: number; // 1 to 16,384
  height: number; // 1 to 16,384
  bytes: number; // 1 to 2,147,483,648
}

/**
 * The second part: z-depth, row by row, little-endian, the same view as the colour.
 *
 * 0 (or, for floats, anything that is not finite and positive) is unknown, and so is 65535 mm.
 */
export interface DepthPart {
  format: DepthFormat;
  encoding?: PlaneEncoding; // default "raw"
  width: number; // 1 to 16,384
  height: number; // 1 to 16,384
  bytes: number; // 1 to 2,147,483,648
}

/**
 * One form in which light is wanted.
 *
 * size:         height of exr, hdr, png, npy and confidence, 8 to 512 (default: as computed); side of a face of cube,
 *               ktx2 and specular, 16, 32, 64, 128 or 256 (default 32).
 * kind:         for sh: total, or ambient (without the main light).
 * basis:        for sh: arcore (27 interleaved, Condon-Shortley phase; WebXR's too), arkit (27 planar, that phase),
 *               threejs (27 interleaved, signs all positive).
 * exposure_ev:  for png: radiance 2^-exposure_ev is white.
 */
export interface LightForm {
  format: LightFormat;
  size?: number | null; // 8 to 512
  kind?: Kind; // default "total"
  basis?: Basis; // default "arcore"
  exposure_ev?: number; // -16 to 16; default 0.0
}

/**
 * Frames of a session so far. accepted = processed + superseded + skipped + queued.
 *
 * gaps: indices between the first and the last accepted that never came.
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

/** WebSocket, to the client: what became of a frame. */
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
 * Everything about a frame but its pixels.
 *
 * index:            needed on a WebSocket; over HTTP the address has it, and if given here it must be the same.
 * camera_to_world:  16 numbers, column by column, as a `simd_float4x4` stands in memory: x axis, y axis, z axis,
 *                   position.
 * exposure:         how much light the image took, in units of the session's reference exposure (for instance shutter
 *                   seconds x ISO): linear radiance is divided by exposure / reference.
 * tracking_state:   ARKit's; frames that are not `normal` are not used unless the session asks for it.
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
 * What became of a frame.
 *
 * status:   processed: the light has it. superseded: a newer frame came before this one's turn. queued: accepted, its
 *           turn is to come (only with `Prefer: respond-async`). skipped: its tracking state rules it out.
 * replay:   the same index and bytes had been sent before: nothing was done again.
 * coverage: of each named probe, after the last processed frame.
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

/** WebSocket, to the server: light now. The answer carries the same `request`. */
export interface LightCall {
  probes: readonly ProbeQuery[]; // 1 to 64 of them
  forms: readonly LightForm[]; // 1 to 8 of them
  type: "light";
  request?: string; // default ""
}

/**
 * One form of one probe's light.
 *
 * values: for sh and main_light, the numbers themselves.
 * data:   for the others in JSON, base64; in a binary light message `bytes` is their length instead.
 */
export interface EncodedLight {
  format: LightFormat;
  media_type: string;
  values?: { readonly [name: string]: unknown } | null;
  data?: string | null;
  bytes?: number | null;
}

/** Light at several points, each in every one of the forms, all at one moment of the session. */
export interface LightRequest {
  probes: readonly ProbeQuery[]; // 1 to 64 of them
  forms: readonly LightForm[]; // 1 to 8 of them
}

/**
 * Light after `frame` (the index of the last processed frame), in the order it was asked for.
 *
 * frame: -1 before the first: the light is then the prior, grey and brighter from above, with coverage 0.
 */
export interface LightResponse {
  frame: number;
  results: readonly ProbeLight[];
}

/** WebSocket, to the client: the named probes' light after a frame, if any is subscribed to. */
export interface LightingUpdate {
  frame: number;
  results: readonly ProbeLight[];
  type: "lighting";
}

/** Bytes that the session holds now, and the most it can come to with these options. */
export interface Memory {
  bytes: number;
  bound_bytes: number;
}

/** Where a named probe is, in world metres. */
export interface ProbeBody {
  position: Position;
}

/**
 * The light at one point. `coverage`: share of the sphere that was observed, by solid angle, 0 to 1.
 *
 * etag: the same as long as the light at this point is.
 */
export interface ProbeLight {
  position: Position;
  name?: string | null;
  coverage: number;
  etag: string;
  forms: readonly EncodedLight[];
}

/** A point: a position in world metres, or the name of a tracked probe. */
export interface ProbeQuery {
  position?: Position | null;
  name?: string | null; // ^[A-Za-z0-9_-]{1,64}$
}

/** WebSocket, to the client: the named probes, after `track` or `untrack`. */
export interface ProbesEvent {
  type: "probes";
  probes: { readonly [name: string]: Position };
}

/** RFC 9457: why a request was refused. `field`, `value`, `rule`: where, what stood there, what would be right. */
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
 * WebSocket, to the client: a message was refused; the connection goes on.
 *
 * index:   of the frame it was about, if its header could be read.  request: of the `light` message.
 */
export interface ProblemEvent {
  type: "problem";
  problem: Problem;
  index?: number | null;
  request?: string | null;
}

/**
 * What a session is to be; sent again with the same values it changes nothing.
 *
 * height:              of the panoramas in pixels; their width is twice that.
 * reference_exposure:  the exposure that shows radiance 1.0 as white, in the frames' unit; null: the first frame's.
 * use_limited_tracking: take frames whose tracking is `limited` too. Their poses can be wrong, and what they
 *                      smear over the room stays: hence not by default.
 * min_confidence:      depth pixels below this confidence (0, 1, 2) are unknown.
 */
export interface SessionRequest {
  mode?: ModelName; // default "auto"
  height?: number; // 16 to 512; default 120
  reference_exposure?: number | null; // 1e-06 to 1,000,000
  use_limited_tracking?: boolean; // default false
  min_confidence?: number; // 0 to 2; default 1
  unknown_depth?: "rim" | "far" | "drop"; // default "rim"
}

/** A session. `status`: open; failed, after an engine error (delete it and open it anew). */
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

/** WebSocket, to the server: send every named probe's light in these forms, now and after each frame; none: stop. */
export interface Subscribe {
  type: "subscribe";
  forms: readonly LightForm[]; // 0 to 8 of them
}

/** WebSocket, to the server: follow this point from now on; a name that is taken moves. */
export interface Track {
  type: "track";
  name: string; // ^[A-Za-z0-9_-]{1,64}$
  position: Position;
}

/** WebSocket, to the server: no longer follow it. */
export interface Untrack {
  type: "untrack";
  name: string; // ^[A-Za-z0-9_-]{1,64}$
}

/** The lighting volume, in the world: a box of `shape` (z, y, x) voxels of `voxel_m`. */
export interface Volume {
  shape: readonly number[];
  voxel_m: number;
  depth_max_m: number;
}

/** A pinhole camera in pixels of the colour image; pixel centres at half integers. */
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
