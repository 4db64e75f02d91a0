// Light to check every form with: red grows along +x, green along +y, blue along +z. It is band-limited, so harmonics
// represent it exactly, and no two directions are equal.

import type { Light, LightData, Vector } from "roomlight";

export const radiance = (direction: Vector): Vector => direction.map((part) => 0.5 + 0.4 * part) as unknown as Vector;

export const unit = (direction: Vector): Vector => {
  const length = Math.hypot(...direction);
  return direction.map((part) => part / length) as unknown as Vector;
};

export const DIRECTIONS: readonly Vector[] = [
  [1, 0, 0],
  [-1, 0, 0],
  [0, 1, 0],
  [0, -1, 0],
  [0, 0, 1],
  [0, 0, -1],
  [1, 2, 3],
  [-3, 1, 2],
  [2, -3, -1],
  [-2, -1, 3],
  [3, 1, -2],
].map((direction) => unit(direction as unknown as Vector));

/** The float16 nearest to a number in its normal range, from float32's bits. */
export function toHalf(value: number): number {
  const bits = new Uint32Array(new Float32Array([value]).buffer)[0]!;
  return value === 0 ? 0 : ((bits >>> 16) & 0x8000) | (((bits + 0x1000 - 0x38000000) >>> 13) & 0x7fff);
}

export function fromHalf(half: number): number {
  const [exponent, mantissa] = [(half >> 10) & 31, half & 1023];
  return (
    (half & 0x8000 ? -1 : 1) * (exponent === 0 ? mantissa * 2 ** -24 : (1 + mantissa / 1024) * 2 ** (exponent - 15))
  );
}

/** Direction of a point on a face, `across` along columns and `down` along rows (-1 to 1): OpenGL's table. */
export function faceDirection(face: number, across: number, down: number): Vector {
  const [a, d] = [across, down];
  return unit(
    (
      [
        [1, -d, -a],
        [-1, -d, a],
        [a, 1, d],
        [a, -1, -d],
        [a, -d, 1],
        [-a, -d, -1],
      ] as const
    )[face]!,
  );
}

/** Face and texel that OpenGL samples for a direction. */
export function faceOf([x, y, z]: Vector, side: number): { face: number; row: number; column: number } {
  const [ax, ay, az] = [Math.abs(x), Math.abs(y), Math.abs(z)];
  const [face, across, down, major] =
    ax >= ay && ax >= az
      ? x > 0
        ? [0, -z, -y, ax]
        : [1, z, -y, ax]
      : ay >= az
        ? y > 0
          ? [2, x, z, ay]
          : [3, x, -z, ay]
        : z > 0
          ? [4, x, -y, az]
          : [5, -x, -y, az];
  const texel = (along: number) => Math.min(Math.floor(((along / major + 1) / 2) * side), side - 1);
  return { face, row: texel(down), column: texel(across) };
}

/** Faces +X -X +Y -Y +Z -Z as RGBA float16; alpha 0, as for unobserved directions. */
export function cubeBytes(side: number, gain = 1): Uint8Array<ArrayBuffer> {
  const half = new Uint16Array(6 * side * side * 4);
  for (let texel = 0; texel < 6 * side * side; texel++) {
    const [column, row] = [texel % side, Math.floor(texel / side) % side];
    const at = (index: number) => ((index + 0.5) / side) * 2 - 1;
    const rgb = radiance(faceDirection(Math.floor(texel / side / side), at(column), at(row)));
    half.set(
      rgb.map((value) => toHalf(value * gain)),
      4 * texel,
    );
  }
  return new Uint8Array(half.buffer);
}

/** A KTX2 file with these levels, largest first in the index and last in the file. */
export function ktx2Bytes(levels: readonly Uint8Array[], side: number): Uint8Array<ArrayBuffer> {
  const start = 80 + 24 * levels.length;
  const file = new Uint8Array(start + levels.reduce((sum, level) => sum + level.length, 0));
  const view = new DataView(file.buffer);
  file.set([0xab, 0x4b, 0x54, 0x58, 0x20, 0x32, 0x30, 0xbb, 0x0d, 0x0a, 0x1a, 0x0a]);
  [97, 2, side, side, 0, 0, 6, levels.length, 0].forEach((value, at) => view.setUint32(12 + 4 * at, value, true));
  let at = start;
  for (let level = levels.length - 1; level >= 0; level--) {
    const bytes = levels[level]!;
    [at, bytes.length, bytes.length].forEach((value, word) =>
      view.setBigUint64(80 + 24 * level + 8 * word, BigInt(value), true),
    );
    file.set(bytes, at);
    at += bytes.length;
  }
  return file;
}

/** The direction of a panorama's pixel: u = 0.5 + atan2(z, x) / 2 pi, v = acos(y) / pi. */
export function panoramaDirection(column: number, row: number, height: number): Vector {
  const [azimuth, polar] = [((column + 0.5) / (2 * height) - 0.5) * 2 * Math.PI, ((row + 0.5) / height) * Math.PI];
  return [Math.sin(polar) * Math.cos(azimuth), Math.cos(polar), Math.sin(polar) * Math.sin(azimuth)];
}

/** A Radiance HDR file, flat or run-length coded (with literal runs of at most 127 values). */
export function hdrBytes(height: number, coded: boolean): Uint8Array<ArrayBuffer> {
  const width = 2 * height;
  const out = [...new TextEncoder().encode(`#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y ${height} +X ${width}\n`)];
  for (let row = 0; row < height; row++) {
    const texels = Array.from({ length: width }, (_, column) => {
      const rgb = radiance(panoramaDirection(column, row, height));
      const exponent = Math.floor(Math.log2(Math.max(...rgb))) + 1;
      return [...rgb.map((value) => Math.floor((value / 2 ** exponent) * 256)), exponent + 128];
    });
    if (!coded) {
      out.push(...texels.flat());
      continue;
    }
    out.push(2, 2, width >> 8, width & 255);
    for (let channel = 0; channel < 4; channel++) {
      for (let from = 0; from < width; from += 127) {
        const values = texels.slice(from, from + 127).map((texel) => texel[channel]!);
        const uniform = values.every((value) => value === values[0]);
        out.push(...(uniform ? [128 + values.length, values[0]!] : [values.length, ...values]));
      }
    }
  }
  return Uint8Array.from(out);
}

/** The harmonics of this light, 9 x 3, all signs positive. */
export const COEFFICIENTS: readonly Vector[] = Array.from({ length: 9 }, (_, term) => {
  const even = term === 0 ? 0.5 * Math.sqrt(4 * Math.PI) : 0;
  const slope = 0.4 * Math.sqrt((4 * Math.PI) / 3);
  return [term === 3 ? slope : even, term === 1 ? slope : even, term === 2 ? slope : even] as const;
});

const ODD = [1, 3, 5, 7];

/** The form `sh` of this light in one of the three bases. */
export function harmonicsForm(basis: "arcore" | "arkit" | "threejs", kind: "total" | "ambient" = "total"): LightData {
  const phase = basis === "threejs" ? "positive" : "condon-shortley";
  const signed = COEFFICIENTS.map((rgb, term) =>
    rgb.map((value) => (phase !== "positive" && ODD.includes(term) ? -value : value)),
  );
  const coefficients =
    basis === "arkit" ? [0, 1, 2].flatMap((channel) => signed.map((rgb) => rgb[channel]!)) : signed.flat();
  const layout = basis === "arkit" ? "planar" : "interleaved";
  return {
    format: "sh",
    media_type: "application/json",
    values: { coefficients, layout, phase, quantity: "radiance", kind },
  };
}

export const MAIN_LIGHT: LightData = {
  format: "main_light",
  media_type: "application/json",
  values: { direction: unit([1, 2, 2]), intensity: [3, 2, 1], shadow_strength: 0.4 },
};

export const light = (forms: readonly LightData[], etag = "a"): Light => ({
  position: [1, 2, 3],
  coverage: 0.5,
  etag,
  forms,
});
export const binary = (format: LightData["format"], data: Uint8Array<ArrayBuffer>): LightData => ({
  format,
  media_type: "application/octet-stream",
  data,
});
