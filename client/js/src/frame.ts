// A frame as bytes: "RLF1", the length of the header (u32, little-endian), the header as JSON, then colour, and
// optionally depth and its confidence. Typed arrays are sent as they are in memory; every browser stores them little-endian.

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

/** Bytes in any form that a browser has; a promise of a Blob is an image that is still being encoded. */
export type Binary = ArrayBuffer | ArrayBufferView | Blob | Promise<Blob>;

/**
 * A frame to send: the wire's header, whose parts have data instead of lengths.
 *
 * camera_to_world: 16 numbers, column by column: `XRRigidTransform.matrix`, or `Matrix4.elements` of three.js.
 * index:           by default the session's next index.
 * depth:           without it the server estimates depth.
 */
export interface Frame extends Omit<FrameHeader, "version" | "colour" | "depth" | "confidence" | "camera_to_world"> {
  colour: Omit<ColourPart, "bytes"> & { data: Binary };
  depth?: (Omit<DepthPart, "bytes"> & { data: Binary }) | null | undefined;
  confidence?: (Omit<ConfidencePart, "bytes"> & { data: Binary }) | null | undefined;
  camera_to_world: ArrayLike<number>;
}

/** The message of a frame. Throws RangeError if the header's numbers contradict each other; the server checks more. */
export async function packFrame(frame: Frame): Promise<Uint8Array<ArrayBuffer>> {
  const { colour, depth, confidence, camera_to_world, ...rest } = frame;
  const parts = await Promise.all(
    [colour, depth, confidence].map(async (part) => (part ? toBytes(part.data) : new Uint8Array(0))),
  );
  const [colourBytes, depthBytes, confidenceBytes] = parts.map((part) => part.length);
  if (camera_to_world.length !== 16) {
    throw new RangeError(`camera_to_world: must be 16 numbers, column by column, got ${camera_to_world.length}`);
  }
  const raw = depth ? depth.width * depth.height * DEPTH_BYTES[depth.format] : 0;
  if (depth && (depth.encoding ?? "raw") === "raw" && depthBytes !== raw) {
    throw new RangeError(
      `depth: ${depth.format} of ${depth.width} x ${depth.height} must be ${raw} bytes, got ${depthBytes}`,
    );
  }
  const header: FrameHeader = {
    ...rest,
    exposure: rest.exposure ?? 1,
    tracking_state: rest.tracking_state ?? "normal",
    version: VERSION,
    camera_to_world: Array.from(camera_to_world),
    colour: described(colour, colourBytes!),
    depth: depth && { encoding: "raw", ...described(depth, depthBytes!) },
    confidence: confidence && { format: "uint8", encoding: "raw", ...described(confidence, confidenceBytes!) },
  };
  const text = new TextEncoder().encode(canonicalJson(header));
  if (text.length > MAX_HEADER_BYTES) {
    throw new RangeError(`the header must be at most ${MAX_HEADER_BYTES} bytes, got ${text.length}`);
  }
  return join([prefix(FRAME_MAGIC, text.length), text, ...parts]);
}

function described<Part extends { data: Binary }>({ data: _data, ...part }: Part, bytes: number) {
  return { ...part, bytes };
}

/**
 * The canonical JSON of a header, the same in all clients: sorted keys, no spaces, no nulls, whole numbers without a
 * decimal point, other numbers in their shortest form, with an exponent below 0.0001. Throws RangeError if a number is
 * not finite.
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
    throw new RangeError(`numbers of a header must be finite, got ${value}`);
  }
  if (Number.isSafeInteger(value)) {
    return String(value + 0); // + 0: minus zero becomes 0
  }
  const magnitude = Math.abs(value);
  if (magnitude < 1e-4 || magnitude >= 1e16) {
    return value.toExponential().replace(/e([+-])(\d)$/, "e$10$2"); // 1.5e-05, as Python and Swift write it
  }
  return Number.isInteger(value) ? `${value}.0` : String(value);
}

/** The bytes of binary data, without a copy where possible. */
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
  const joined = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let offset = 0;
  for (const part of parts) {
    joined.set(part, offset);
    offset += part.length;
  }
  return joined;
}
