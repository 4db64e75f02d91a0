// The test vector shared by all clients, and a frame that every server accepts.

import { readFileSync } from "node:fs";
import type { Frame, FrameHeader } from "roomlight";

const FOLDER = new URL("../../../../tests/core/", import.meta.url);

interface Vector {
  name: string;
  frame: Frame;
  bytes: Buffer;
}

interface VectorEntry {
  name: string;
  header: FrameHeader;
  parts: Record<"colour" | "depth" | "confidence", string>;
  offset: number;
  length: number;
}

export function vectors(): Vector[] {
  const { file, vectors: entries } = JSON.parse(readFileSync(new URL("wire_vector.json", FOLDER), "utf8")) as {
    file: string;
    vectors: VectorEntry[];
  };
  const whole = readFileSync(new URL(file, FOLDER));
  return entries.map(({ name, header, parts, offset, length }) => {
    const { version: _version, colour, depth, confidence, ...rest } = header;
    const data = (part: keyof typeof parts) => new Uint8Array(Buffer.from(parts[part], "hex"));
    const frame: Frame = {
      ...rest,
      colour: { ...colour, data: data("colour") },
      depth: depth && { ...depth, data: data("depth") },
      confidence: confidence && { ...confidence, data: data("confidence") },
    };
    return { name, frame, bytes: whole.subarray(offset, offset + length) };
  });
}

/** A grey image of 4 x 3 pixels, 1.5 m away. */
export function plainFrame(): Frame {
  return {
    colour: { encoding: "rgb8", data: new Uint8Array(36).fill(128) },
    depth: { format: "uint16_mm", width: 4, height: 3, data: new Uint16Array(12).fill(1500) },
    intrinsics: { fx: 3.5, fy: 3.5, cx: 2, cy: 1.5, width: 4, height: 3 },
    camera_to_world: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  };
}
