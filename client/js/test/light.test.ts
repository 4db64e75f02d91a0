// Light messages, harmonics, cube files and Radiance HDR, each compared with light that is known in every direction.

import assert from "node:assert/strict";
import { test } from "node:test";
import {
  parseCube,
  decodeLights,
  findForm,
  Harmonics,
  parseHdr,
  parseLights,
  type LightData,
  type Vector,
} from "roomlight";
import * as field from "./light_field.js";
import { lightMessage } from "./server.js";

const close = (actual: readonly number[], wanted: readonly number[], within: number) =>
  actual.forEach((value, at) => assert.ok(Math.abs(value - wanted[at]!) <= within, `${actual} is not ${wanted}`));

test("a light message is parsed part by part", () => {
  const form = (bytes: number) => ({ format: "exr", media_type: "m", bytes });
  const sh = { format: "sh", media_type: "j", values: { a: 1 } };
  const result = (forms: object[]) => ({ position: [0, 0, 0], coverage: 1, etag: "e", forms });
  const json = { frame: 3, results: [result([form(2), sh]), result([form(1)])] };
  const body = new Uint8Array(lightMessage(json, [Uint8Array.of(1, 2), Uint8Array.of(3)])).buffer;
  const [first, second] = parseLights(body).results;
  assert.deepEqual(first!.forms, [{ format: "exr", media_type: "m", data: Uint8Array.of(1, 2) }, sh]);
  assert.deepEqual(second!.forms[0]!.data, Uint8Array.of(3));
  assert.equal(findForm(first!, "cube", "sh"), first!.forms[1]);
  assert.equal(findForm(second!, "sh"), undefined);
  for (const malformed of [
    body.slice(0, 7),
    body.slice(1),
    body.slice(0, 60),
    body.slice(0, -1),
    new Uint8Array([...new Uint8Array(body), 0]).buffer,
  ]) {
    assert.throws(() => parseLights(malformed), RangeError);
  }
  const text = { frame: 3, results: [result([{ format: "exr", media_type: "m", data: "AQI=" }, sh])] };
  assert.deepEqual(decodeLights(text as never).results[0], first);
});

test("harmonics of every basis give the same light", () => {
  for (const basis of ["arcore", "arkit", "threejs"] as const) {
    const harmonics = Harmonics.of(field.harmonicsForm(basis));
    for (const direction of field.DIRECTIONS) {
      close(harmonics.radiance(direction), field.radiance(direction), 1e-12);
      // A cosine lobe takes pi of the mean, 2 pi / 3 of the slope.
      close(
        harmonics.irradiance(direction),
        direction.map((part) => Math.PI * 0.5 + ((2 * Math.PI) / 3) * 0.4 * part),
        1e-12,
      );
    }
  }
  for (const malformed of [
    field.MAIN_LIGHT,
    { format: "sh", media_type: "j" },
    { ...field.harmonicsForm("arkit"), values: { coefficients: [1] } },
  ]) {
    assert.throws(() => Harmonics.of(malformed as LightData), RangeError);
  }
});

test("harmonics without the main light are the remaining light", () => {
  const [direction, intensity]: [Vector, Vector] = [field.unit([1, -2, 0.5]), [3, 2, 1]];
  const rest = Harmonics.of(field.harmonicsForm("threejs")).without(direction, intensity);
  // The subtracted light integrates to the intensity, as its first coefficient shows.
  const removed = Harmonics.of(field.harmonicsForm("threejs")).coefficients[0]!.map(
    (value, at) => value - rest.coefficients[0]![at]!,
  );
  close(
    removed.map((value) => value * Math.sqrt(4 * Math.PI)),
    intensity,
    1e-12,
  );
  const facing = field.DIRECTIONS.map(
    (normal) => rest.irradiance(normal)[0] - (Math.PI * 0.5 + ((2 * Math.PI) / 3) * 0.4 * normal[0]),
  );
  const least = field.DIRECTIONS[facing.indexOf(Math.min(...facing))]!;
  assert.ok(least.reduce((sum, part, at) => sum + part * direction[at]!, 0) > 0.8);
});

test("cubes are plain, KTX2, and KTX2 with mips", () => {
  const side = 8;
  const levels = [field.cubeBytes(side), field.cubeBytes(4, 0.5)];
  const plain = parseCube(field.binary("cube", levels[0]!));
  const single = parseCube(field.binary("ktx2", field.ktx2Bytes(levels.slice(0, 1), side)));
  const mipped = parseCube(field.binary("specular", field.ktx2Bytes(levels, side)));
  assert.deepEqual(single, plain);
  assert.deepEqual(mipped.levels[0], plain.levels[0]);
  assert.deepEqual(
    [mipped.size, mipped.levels.length, mipped.levels[1]!.length, mipped.levels[1]![0]!.length],
    [8, 2, 6, 4 * 4 * 4],
  );
  for (const direction of field.DIRECTIONS) {
    const { face, row, column } = field.faceOf(direction, side);
    const texel = plain.levels[0]![face]!.subarray((row * side + column) * 4).slice(0, 3);
    close(Array.from(texel, field.fromHalf), field.radiance(direction), 0.4 * (2 / side));
  }
});

test("a malformed cube is refused", () => {
  const file = field.ktx2Bytes([field.cubeBytes(4)], 4);
  const changed = (at: number, value: number) =>
    field.binary(
      "ktx2",
      Uint8Array.from(file, (byte, index) => (index === at ? value : byte)),
    );
  for (const form of [
    field.binary("cube", new Uint8Array(6 * 8 * 5)),
    field.binary("cube", new Uint8Array(0)),
    field.binary("exr", field.cubeBytes(4)),
    field.binary("ktx2", file.slice(0, 70)),
    field.binary("ktx2", file.slice(0, -1)),
    changed(0, 0),
    changed(12, 98), // another format
    changed(36, 1), // one face
    changed(44, 1), // supercompressed
    changed(20, 5), // 5 x 4
    { format: "cube", media_type: "m" } as LightData,
  ]) {
    assert.throws(() => parseCube(form), RangeError);
  }
});

test("Radiance HDR is parsed, flat and run-length coded", () => {
  const height = 16;
  for (const file of [field.hdrBytes(height, false), field.hdrBytes(height, true)]) {
    const panorama = parseHdr(file);
    assert.deepEqual([panorama.width, panorama.height], [32, 16]);
    for (const [column, row] of [
      [0, 0],
      [31, 15],
      [5, 3],
      [20, 9],
    ] as const) {
      const pixel = panorama.rgb.subarray((row * 32 + column) * 3).slice(0, 3);
      close([...pixel], field.radiance(field.panoramaDirection(column, row, height)), 1 / 128);
    }
    for (const malformed of [file.slice(0, -1), file.slice(0, 20), file.slice(1), new Uint8Array(0)]) {
      assert.throws(() => parseHdr(malformed), RangeError);
    }
  }
  const black = new TextEncoder().encode("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n");
  assert.deepEqual(
    parseHdr(new Uint8Array([...black, 255, 0, 0, 0, 128, 64, 32, 129])).rgb,
    Float32Array.of(0, 0, 0, 1, 0.5, 0.25),
  );
});
