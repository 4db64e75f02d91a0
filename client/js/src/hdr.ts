// Radiance HDR (RGBE) files with rows from the top, which the server and most other programs write.

/** Linear RGB, row by row from the top (+Y), float32 [height, width, 3]. */
export interface Panorama {
  width: number;
  height: number;
  rgb: Float32Array<ArrayBuffer>;
}

/** The image of a .hdr file. Throws RangeError if the file is malformed or truncated. */
export function parseHdr(data: Uint8Array): Panorama {
  const end = headerEnd(data);
  const header = new TextDecoder().decode(data.subarray(0, end));
  const size = /-Y (\d+) \+X (\d+)\n$/.exec(header);
  if (!header.startsWith("#?") || !header.includes("32-bit_rle_rgbe") || !size) {
    throw new RangeError(`expected a Radiance HDR file with rows from the top, got ${data.length} other bytes`);
  }
  const [height, width] = [Number(size[1]), Number(size[2])];
  const rgb = new Float32Array(height * width * 3);
  const line = new Uint8Array(width * 4); // planar: all red, green, blue, then exponents
  let at = end;
  for (let row = 0; row < height; row++) {
    at = readLine(data, at, line, width);
    for (let column = 0; column < width; column++) {
      const exponent = line[3 * width + column]!;
      const scale = exponent === 0 ? 0 : 2 ** (exponent - 136); // bias 128, mantissa of 8 bits
      for (let channel = 0; channel < 3; channel++) {
        rgb[(row * width + column) * 3 + channel] = line[channel * width + column]! * scale;
      }
    }
  }
  return { width, height, rgb };
}

/** Offset of the pixels: after the line with the size, which follows an empty line. */
function headerEnd(data: Uint8Array): number {
  const newline = 10;
  for (let at = 1; at < Math.min(data.length, 4096); at++) {
    if (data[at] === newline && data[at - 1] === newline) {
      return data.indexOf(newline, at + 1) + 1;
    }
  }
  return 0;
}

/** Read one row, run-length coded or flat, into `line`; returns the offset of the next row. */
function readLine(data: Uint8Array, at: number, line: Uint8Array, width: number): number {
  const coded =
    data[at] === 2 &&
    data[at + 1] === 2 &&
    width >= 8 &&
    width < 0x8000 &&
    (data[at + 2]! << 8) + data[at + 3]! === width;
  if (!coded) {
    if (at + 4 * width > data.length) {
      throw truncated(data);
    }
    for (let index = 0; index < 4 * width; index++) {
      line[(index % 4) * width + (index >> 2)] = data[at + index]!;
    }
    return at + 4 * width;
  }
  at += 4;
  for (let to = 0; to < 4 * width;) {
    const count = data[at++] ?? 0;
    const run = count > 128 ? count - 128 : count;
    const used = count > 128 ? 1 : run;
    if (run === 0 || to + run > 4 * width || at + used > data.length) {
      throw truncated(data);
    }
    if (count > 128) {
      line.fill(data[at]!, to, to + run);
    } else {
      line.set(data.subarray(at, at + run), to);
    }
    to += run;
    at += used;
  }
  return at;
}

function truncated(data: Uint8Array): RangeError {
  return new RangeError(`a Radiance HDR file of ${data.length} bytes has malformed or truncated rows`);
}
