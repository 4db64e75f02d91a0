// Frames as bytes: the test vector shared by all clients, and frames that are refused before they are sent.

import assert from "node:assert/strict";
import { test } from "node:test";
import { canonicalJson, packFrame, type Frame } from "roomlight";
import { plainFrame, vectors } from "./vectors.js";

test("the shared vector is packed byte for byte", async () => {
  for (const { name, frame, bytes } of vectors()) {
    assert.deepEqual(Buffer.from(await packFrame(frame)), bytes, name);
  }
  assert.equal(vectors().length, 3);
});

test("parts may be blobs, promises of blobs, buffers or views", async () => {
  const { frame, bytes } = vectors()[0]!;
  const colour = new Uint8Array(frame.colour.data as Uint8Array);
  const shifted = new Uint8Array([9, ...colour, 9]).subarray(1, 1 + colour.length);
  for (const data of [
    new Blob([colour]),
    Promise.resolve(new Blob([colour])),
    colour.buffer,
    new DataView(colour.buffer),
    shifted,
  ]) {
    assert.deepEqual(Buffer.from(await packFrame({ ...frame, colour: { ...frame.colour, data } })), bytes);
  }
});

test("numbers have one canonical text", () => {
  const texts: [number, string][] = [
    [1, "1"],
    [-0, "0"],
    [12.125, "12.125"],
    [0.1 + 0.2, "0.30000000000000004"],
    [1e-5, "1e-05"],
    [-1.5e-7, "-1.5e-07"],
    [1e-4, "0.0001"],
    [2.5e-300, "2.5e-300"],
    [1e6, "1000000"],
    [2 ** 53, "9007199254740992.0"],
    [1e16, "1e+16"],
  ];
  for (const [value, text] of texts) {
    assert.equal(canonicalJson(value), text);
  }
  assert.equal(canonicalJson({ b: [1, null], a: { d: undefined, c: "é" } }), '{"a":{"c":"é"},"b":[1,null]}');
  assert.throws(() => canonicalJson({ a: NaN }), RangeError);
  assert.throws(() => canonicalJson([Infinity]), RangeError);
});

test("contradictory frames are refused", async () => {
  const refused = async (changes: Partial<Frame>, message: RegExp) =>
    assert.rejects(
      packFrame({ ...plainFrame(), ...changes }),
      (error) => error instanceof RangeError && message.test(error.message),
    );
  await refused({ camera_to_world: [1, 2, 3] }, /16 numbers.*got 3/);
  await refused({ camera_to_world: Array(16).fill(NaN) }, /finite/);
  await refused(
    { depth: { format: "float32_m", width: 4, height: 3, data: new Uint8Array(24) } },
    /must be 48 bytes, got 24/,
  );
});

test("undefined fields get their defaults", async () => {
  const packed = await packFrame({ ...plainFrame(), exposure: undefined as never, tracking_state: undefined as never });
  assert.deepEqual(packed, await packFrame(plainFrame()));
});
