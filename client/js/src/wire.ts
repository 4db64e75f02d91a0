// The wire format (docs/wire.md): its message types, generated in schemas.ts, and its names and constants.

import type { DepthPart, LightForm, Position } from "./schemas.js";

export type * from "./schemas.js";

/** A position as an app may have it. */
export type PositionLike = Position | Float32Array | Float64Array;
export type DepthFormat = DepthPart["format"];
export type LightFormat = LightForm["format"];
export type LightUse = NonNullable<LightForm["use"]>;

export const FRAME_MAGIC = "RLF1";
export const LIGHT_MAGIC = "RLL1";
export const FRAME_MEDIA_TYPE = "application/vnd.roomlight.frame";
export const LIGHT_MEDIA_TYPE = "application/vnd.roomlight.light";
export const VERSION = 1;
export const MAX_HEADER_BYTES = 16384;
/** Bytes per depth value, little-endian. */
export const DEPTH_BYTES: Readonly<Record<DepthFormat, number>> = { uint16_mm: 2, float16_m: 2, float32_m: 4 };
