// A frame as bytes: "RLF1", the length of the header (u32, little-endian), the header in JSON, then colour, depth and,
// if there is one, confidence. Typed arrays are sent as they stand in memory, which every browser keeps little-endian.

import {
  DEPTH_BYTES,
  FRAME_MAGIC,
  MAX_HEADER_BYTES,
  VERSION,
  type ColourPart,
  type ConfidencePart,
  type DepthPart,
  type FrameHeader,
} from "./wire.js";

/** Bytes, from wherever a browser has them, or will have them: an image that is still being encoded. */
export type Binary = ArrayBuffer | ArrayBufferView | Blob | Promise<Blob>;

/**
 * A frame to send: the header of the wire, its parts with their data in place of their lengths.
 *
 * camera_to_world: 16 numbers, column by column: `XRRigidTransform.matrix`, or `Matrix4.elements` of three.js.
 * index:           left out, the session counts.
 */
export interface Frame extends Omit<FrameHeader, "version" | "colour" | "depth" | "confidence" | "camera_to_world"> {
  colour: Omit<ColourPart, "bytes"> & { data: Binary };
  depth: Omit<DepthPart, "bytes"> & { data: Binary };
  confidence?: (Omit<ConfidencePart, "bytes"> & { data: Binary }) | null;
  camera_to_world: ArrayLike<number>;
}

/** The frame's message. RangeError for what the header's own numbers show to be wrong; the server checks the rest. */
export async function packFrame(frame: Frame): Promise<Uint8Array<ArrayBuffer>> {
  const { colour, depth, confidence, camera_to_world, ...rest } = frame;
  const parts = await Promise.all(
    [colour, depth, ...(confidence ? [confidence] : [])].map((part) => toBytes(part.data)),
  );
  const [colourBytes, depthBytes, confidenceBytes] = parts.map((part) => part.length);
  if (camera_to_world.length !== 16) {
    throw new RangeError(`camera_to_world: 16 numbers, column by column, got ${camera_to_world.length}`);
  }
  const raw = depth.width * depth.height * DEPTH_BYTES[depth.format];
  if ((depth.encoding ?? "raw") === "raw" && depthBytes !== raw) {
    throw new RangeError(
      `depth: ${depth.format} of ${depth.width} x ${depth.height} takes ${raw} bytes, got ${depthBytes}`,
    );
  }
  const header: FrameHeader = {
    ...rest,
    exposure: rest.exposure ?? 1,
    tracking_state: rest.tracking_state ?? "normal",
    version: VERSION,
    colour: { encoding: colour.encoding, bytes: colourBytes! },
    depth: {
      format: depth.format,
      encoding: depth.encoding ?? "raw",
      width: depth.width,
      height: depth.height,
      bytes: depthBytes!,
    },
    camera_to_world: Array.from(camera_to_world),
  };
  if (confidence) {
    const { width, height, encoding = "raw" } = confidence;
    header.confidence = { format: "uint8", encoding, width, height, bytes: confidenceBytes! };
  }
  const text = new TextEncoder().encode(canonicalJson(header));
  if (text.length > MAX_HEADER_BYTES) {
    throw new RangeError(`the header takes ${text.length} bytes, at most ${MAX_HEADER_BYTES}`);
  }
  return join([prefix(FRAME_MAGIC, text.length), text, ...parts]);
}

/**
 * JSON in the one way in which all clients write a header: keys sorted, no spaces, no nulls, whole numbers without a
 * point, others in their shortest form with an exponent below 0.0001. RangeError for numbers that are not finite.
 */
export function canonicalJson(value: unknown): string {
  if (typeof value === "number") {
    return numberText(value);
  }
  if (Array.isArray(value)) {
    return `[${value.map(canonicalJson).join(",")}]`;
  }
  if (typeof value === "object" && value !== null) {
    const entries = Object.entries(value).filter(([, item]) => item !== null && item !== undefined);
    entries.sort(([a], [b]) => (a < b ? -1 : 1));
    return `{${entries.map(([key, item]) => `${JSON.stringify(key)}:${canonicalJson(item)}`).join(",")}}`;
  }
  return JSON.stringify(value);
}

function numberText(value: number): string {
  if (!Number.isFinite(value)) {
    throw new RangeError(`a header holds finite numbers, got ${value}`);
  }
  if (Number.isSafeInteger(value)) {
    return String(value + 0); // + 0: minus zero is written 0
  }
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e16) {
    return value.toExponential().replace(/e([+-])(\d)$/, "e$10$2"); // 1.5e-05, as Python and Swift write it
  }
  return Number.isInteger(value) ? `${value}.0` : String(value);
}

/** What these bytes are, without a copy where that can be. */
export async function toBytes(data: Binary): Promise<Uint8Array<ArrayBuffer>> {
  if (ArrayBuffer.isView(data)) {
    return new Uint8Array(data.buffer as ArrayBuffer, data.byteOffset, data.byteLength);
  }
  return new Uint8Array(data instanceof ArrayBuffer ? data : await (await data).arrayBuffer());
}

function prefix(magic: string, length: number): Uint8Array<ArrayBuffer> {
  const bytes = new Uint8Array(8);
  bytes.set(new TextEncoder().encode(magic));
  new DataView(bytes.buffer).setUint32(4, length, true);
  return bytes;
}

function join(parts: readonly Uint8Array[]): Uint8Array<ArrayBuffer> {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}
