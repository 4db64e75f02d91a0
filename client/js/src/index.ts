// The client of `roomlight serve`: send camera frames, get HDR light. No dependencies; for browsers and Node.

export { RoomLightError } from "./errors.js";
export { canonicalJson, packFrame, type Binary, type Frame } from "./frame.js";
export { Harmonics, type HarmonicsValues, type LightSourceValues, type MainLightValues, type Vector } from "./harmonics.js";
export type { ClientOptions } from "./http.js";
export { parseHdr, type Panorama } from "./hdr.js";
export { parseCube, type Cube } from "./cube.js";
export { decodeLights, findForm, findFormFor, parseLights, useOf, type Light, type LightData, type Lights } from "./light.js";
export type { BufferOptions } from "./memory.js";
export type { ReconnectOptions } from "./reconnect.js";
export { RoomLight, Session, type CallOptions, type CompositeFile, type LightFile, type ObjectOptions, type SessionOptions } from "./session.js";
export { Stream, type StreamOptions, type StreamStatus } from "./stream.js";
export * from "./wire.js";
