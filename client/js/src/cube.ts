// Cube maps of RGBA float16: plain faces (`cube`) and KTX2 files (`ktx2`, and `specular` with its mips). The faces are
// +X -X +Y -Y +Z -Z with OpenGL's rows and columns.

import type { LightData } from "./light.js";

/** levels[mip][face]: the bits of float16 RGBA, row by row. Faces of level 0 are `size` texels wide, then half each. */
export interface Cube {
  size: number;
  levels: readonly (readonly Uint16Array<ArrayBuffer>[])[];
}

const KTX2_MAGIC = "\xabKTX 20\xbb\r\n\x1a\n";
const R16G16B16A16_SFLOAT = 97; // VkFormat
const TEXEL_BYTES = 8;

/** The cube map of a form `cube`, `ktx2` or `specular`. Throws RangeError if it is malformed or truncated. */
export function parseCube(form: LightData): Cube {
  const { data } = form;
  if (data && (form.format === "ktx2" || form.format === "specular")) {
    return parseKtx2(data);
  }
  const size = Math.sqrt((data?.length ?? 0) / (6 * TEXEL_BYTES));
  if (form.format !== "cube" || !data || !Number.isInteger(size) || size < 1) {
    throw new RangeError(
      `expected six square faces of RGBA float16, got a form ${form.format} of ${data?.length} bytes`,
    );
  }
  return { size, levels: [faces(data, size)] };
}

function parseKtx2(data: Uint8Array<ArrayBuffer>): Cube {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const magic = String.fromCharCode(...data.subarray(0, 12));
  if (magic !== KTX2_MAGIC || data.length < 80) {
    throw new RangeError(`expected a KTX2 file, got ${data.length} bytes of another kind`);
  }
  const [format, , size, height, depth, layers, faceCount, levelCount, scheme] = Array.from({ length: 9 }, (_, at) =>
    view.getUint32(12 + 4 * at, true),
  ) as [number, number, number, number, number, number, number, number, number];
  if (format !== R16G16B16A16_SFLOAT || faceCount !== 6 || size !== height || depth || layers || scheme) {
    throw new RangeError(
      `expected an uncompressed KTX2 cube of RGBA float16, got VkFormat ${format} with ${faceCount} faces`,
    );
  }
  const levels = Array.from({ length: Math.max(levelCount, 1) }, (_, level) => {
    const entry = 80 + 24 * level; // of the level index: offset, length, uncompressed length, 8 bytes each
    const [start, length] = [Number(view.getBigUint64(entry, true)), Number(view.getBigUint64(entry + 8, true))];
    const side = Math.max(size >> level, 1);
    if (length !== 6 * side * side * TEXEL_BYTES || start + length > data.length) {
      throw new RangeError(`level ${level} of a KTX2 file of ${data.length} bytes is truncated`);
    }
    return faces(data.subarray(start, start + length), side);
  });
  return { size, levels };
}

function faces(data: Uint8Array<ArrayBuffer>, side: number): Uint16Array<ArrayBuffer>[] {
  const length = side * side * TEXEL_BYTES;
  return Array.from({ length: 6 }, (_, face) => new Uint16Array(data.slice(face * length, (face + 1) * length).buffer));
}
