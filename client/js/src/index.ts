// Camera frames in, HDR light out: the client of `roomlight serve`. No dependencies; browsers and Node.

export { RoomLightError } from "./errors.js";
export { canonicalJson, packFrame, type Binary, type Frame } from "./frame.js";
export { Harmonics, type HarmonicsValues, type MainLightValues, type Vector } from "./harmonics.js";
export type { ClientOptions } from "./http.js";
export { parseHdr, type Panorama } from "./hdr.js";
export { cubeOf, type Cube } from "./cube.js";
export { decodeLights, formOf, parseLights, type Light, type LightData, type Lights } from "./light.js";
export { RoomLight, Session, type CallOptions, type Probed } from "./session.js";
export { Stream, type StreamOptions } from "./stream.js";
export * from "./wire.js";
