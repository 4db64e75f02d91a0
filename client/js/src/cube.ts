// Cube maps of RGBA float16: bare faces (`cube`) and KTX2 files (`ktx2`, `specular` with its mips). Faces +X -X +Y -Y +Z
// -Z, rows and columns as OpenGL counts them.

import type { LightData } from "./light.js";

/** levels[mip][face]: float16 as its bits, RGBA, row by row; level 0 has `size` texels a side, each next half of it. */
export interface Cube {
  size: number;
  levels: readonly (readonly Uint16Array<ArrayBuffer>[])[];
}

const KTX2_MAGIC = "\xabKTX 20\xbb\r\n\x1a\n";
const R16G16B16A16_SFLOAT = 97; // VkFormat
const TEXEL_BYTES = 8;

/** The cube in a form `cube`, `ktx2` or `specular`. RangeError if it is none, or cut off. */
export function cubeOf(form: LightData): Cube {
  const { data } = form;
  if (data && (form.format === "ktx2" || form.format === "specular")) {
    return fromKtx2(data);
  }
  const size = Math.sqrt((data?.length ?? 0) / (6 * TEXEL_BYTES));
  if (form.format !== "cube" || !data || !Number.isInteger(size) || size < 1) {
    throw new RangeError(
      `six square faces of RGBA float16 are wanted, got a form ${form.format} of ${data?.length} bytes`,
    );
  }
  return { size, levels: [faces(data, size)] };
}

function fromKtx2(data: Uint8Array<ArrayBuffer>): Cube {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const magic = String.fromCharCode(...data.subarray(0, 12));
  if (magic !== KTX2_MAGIC || data.length < 80) {
    throw new RangeError(`a file of ${data.length} bytes that is no KTX2`);
  }
  const [format, , size, height, depth, layers, faceCount, levelCount, scheme] = Array.from({ length: 9 }, (_, at) =>
    view.getUint32(12 + 4 * at, true),
  ) as [number, number, number, number, number, number, number, number, number];
  if (format !== R16G16B16A16_SFLOAT || faceCount !== 6 || size !== height || depth || layers || scheme) {
    throw new RangeError(
      `a KTX2 cube of RGBA float16, not compressed, is wanted: VkFormat ${format}, ${faceCount} faces`,
    );
  }
  const levels = Array.from({ length: Math.max(levelCount, 1) }, (_, level) => {
    const at = 80 + 24 * level; // the level index: offset, length, length uncompressed, 8 bytes each
    const [start, length] = [Number(view.getBigUint64(at, true)), Number(view.getBigUint64(at + 8, true))];
    const side = Math.max(size >> level, 1);
    if (length !== 6 * side * side * TEXEL_BYTES || start + length > data.length) {
      throw new RangeError(`a KTX2 file of ${data.length} bytes whose level ${level} is cut off`);
    }
    return faces(data.subarray(start, start + length), side);
  });
  return { size, levels };
}

function faces(data: Uint8Array<ArrayBuffer>, side: number): Uint16Array<ArrayBuffer>[] {
  const length = side * side * TEXEL_BYTES;
  return Array.from({ length: 6 }, (_, face) => new Uint16Array(data.slice(face * length, (face + 1) * length).buffer));
}
