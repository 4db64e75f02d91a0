// Against a real server at ROOMLIGHT_SERVER with the token ROOMLIGHT_TOKEN: the shared vector and a plain room over
// HTTP and WebSocket, and every light form compared with the server's panorama.

import assert from "node:assert/strict";
import { test } from "node:test";
import {
  parseCube,
  findForm,
  Harmonics,
  parseHdr,
  RoomLight,
  RoomLightError,
  type LightForm,
  type Frame,
  type Light,
  type Lights,
  type Vector,
} from "roomlight";
import { fromHalf, faceDirection, panoramaDirection } from "../light_field.js";
import { plainFrame, vectors } from "../vectors.js";

const server = new RoomLight(process.env["ROOMLIGHT_SERVER"]!, { token: process.env["ROOMLIGHT_TOKEN"]! });
const options = { model: "classical", height: 32, reference_exposure: 1, use_limited_tracking: true } as const;
const FORMS: LightForm[] = [
  { format: "npy" },
  { format: "hdr" },
  { format: "cube", size: 16 },
  { format: "ktx2", size: 16 },
  { format: "specular", size: 16 },
  { format: "sh", basis: "threejs" },
  { format: "sh", basis: "arkit" },
  { format: "main_light" },
];

/** A camera that looks along -z at a wall 1.5 m away, bright on the left and green on the right. */
function roomFrame(index: number): Frame {
  const [width, height] = [64, 48];
  const colour = new Uint8Array(width * height * 3);
  for (let at = 0; at < width * height; at++) {
    colour.set(at % width < 24 ? [255, 240, 200] : [40, 90, 60], 3 * at);
  }
  return {
    ...plainFrame(),
    index,
    colour: { encoding: "rgb8", data: colour },
    depth: { format: "float32_m", width, height, data: new Float32Array(width * height).fill(1.5) },
    confidence: { width, height, data: new Uint8Array(width * height).fill(2) },
    intrinsics: { fx: 40, fy: 40, cx: 32, cy: 24, width, height },
  };
}

/** The panorama of a form `npy` (NumPy's format, version 1): float32 [height, 2 height, 3]. */
function panoramaOf(light: Light): { height: number; at: (column: number, row: number) => Vector } {
  const data = findForm(light, "npy")!.data!;
  const start = 10 + new DataView(data.buffer).getUint16(8, true);
  const rgb = new Float32Array(data.slice(start).buffer);
  const height = Math.sqrt(rgb.length / 6);
  const at = (column: number, row: number) =>
    [...rgb.subarray((row * 2 * height + column) * 3).slice(0, 3)] as unknown as Vector;
  return { height, at };
}

/** Mean over the sphere of the panorama's radiance times `weight(direction)`, by solid angle. */
function integrate(light: Light, weight: (direction: Vector) => number): Vector {
  const { height, at } = panoramaOf(light);
  const sum = [0, 0, 0];
  for (let row = 0; row < height; row++) {
    const solidAngle =
      (Math.cos((row / height) * Math.PI) - Math.cos(((row + 1) / height) * Math.PI)) * (Math.PI / height);
    for (let column = 0; column < 2 * height; column++) {
      const by = weight(panoramaDirection(column, row, height)) * solidAngle;
      at(column, row).forEach((value, channel) => (sum[channel]! += by * value));
    }
  }
  return sum as unknown as Vector;
}

function deferred<T>() {
  let resolve!: (value: T) => void;
  return { promise: new Promise<T>((found) => (resolve = found)), resolve };
}

const near = (actual: readonly number[], wanted: readonly number[], within: number, what: string) =>
  actual.forEach((value, at) =>
    assert.ok(Math.abs(value - wanted[at]!) <= within, `${what}: ${actual} is not ${wanted}`),
  );

test("the shared vector is accepted over HTTP and WebSocket", async () => {
  const session = await server.open(options);
  const stream = await (await server.open(options)).stream();
  for (const { frame } of vectors()) {
    assert.equal((await session.push(frame)).status, "processed");
    assert.equal((await stream.push(frame)).status, "processed");
  }
  const { frame } = vectors()[2]!;
  assert.equal((await session.push({ ...frame, index: 9 })).replay, true);
  const { frames } = await session.state();
  assert.deepEqual([frames.processed, frames.last_index, frames.replayed], [3, 9, 1]);
  stream.close();
  await session.delete();
  await assert.rejects(session.state(), (error) => error instanceof RoomLightError && error.status === 404);
});

test("every form is the light of the panorama", async () => {
  const session = await server.open(options);
  for (const index of [0, 1]) {
    await session.push(roomFrame(index));
  }
  const light = await session.lightAt([0, 0, -0.5], FORMS);
  assert.ok(light.coverage > 0.03 && light.coverage < 1);
  const { height, at } = panoramaOf(light);
  assert.equal(height, 32);

  const hdr = parseHdr(findForm(light, "hdr")!.data!);
  const cube = parseCube(findForm(light, "cube")!);
  for (let row = 0; row < height; row += 3) {
    for (let column = 0; column < 2 * height; column += 5) {
      const wanted = at(column, row);
      near(
        [...hdr.rgb.subarray((row * 2 * height + column) * 3).slice(0, 3)],
        wanted,
        Math.max(...wanted) / 128,
        "hdr",
      );
    }
  }
  assert.deepEqual(parseCube(findForm(light, "ktx2")!), cube);
  const specular = parseCube(findForm(light, "specular")!);
  assert.ok(specular.levels.length > 2);

  // The cube's texels, placed by OpenGL's table, integrate to the panorama's light and to its first moments.
  const [mean, moments] = [
    [0, 0, 0],
    [0, 0, 0],
  ];
  cube.levels[0]!.forEach((face, number) => {
    for (let texel = 0; texel < 256; texel++) {
      const [a, d] = [((texel % 16) + 0.5) / 8 - 1, (Math.floor(texel / 16) + 0.5) / 8 - 1];
      const solidAngle = 1 / 64 / (1 + a * a + d * d) ** 1.5;
      const red = fromHalf(face[4 * texel]!);
      mean[0]! += red * solidAngle;
      faceDirection(number, a, d).forEach((part, axis) => (moments[axis]! += red * part * solidAngle));
    }
  });
  const total = integrate(light, () => 1)[0];
  near([mean[0]!], [total], 0.02 * total, "integral of the cube");
  near(
    moments,
    [0, 1, 2].map((axis) => integrate(light, (direction) => direction[axis]!)[0]),
    0.03 * total,
    "its moments",
  );

  const forms = light.forms.filter(({ format }) => format === "sh").map((form) => Harmonics.of(form));
  near(forms[0]!.coefficients.flat(), forms[1]!.coefficients.flat(), 1e-5, "bases");
  const normals: Vector[] = [
    [0, 0, -1],
    [1, 0, 0],
    [0, 1, 0],
    [-0.6, 0, -0.8],
  ];
  for (const normal of normals) {
    const cosine = (direction: Vector) =>
      Math.max(
        direction.reduce((sum, part, axis) => sum + part * normal[axis]!, 0),
        0,
      );
    near(forms[0]!.irradiance(normal), integrate(light, cosine), 0.06 * total, "irradiance"); // nine harmonics: a few %
  }
  const { direction } = findForm(light, "main_light")!.values as { direction: Vector };
  assert.ok(direction[0] < -0.3 && direction[2] < -0.25, `the bright wall is ahead on the left, not at ${direction}`);
  await session.delete();
});

test("a tracked point's light arrives after each frame", async () => {
  const session = await server.open(options);
  const [prior, lit, tracked] = [deferred<Lights>(), deferred<Lights>(), deferred<object>()];
  const problems: RoomLightError[] = [];
  const stream = await session.stream({
    onLighting: (lights) => (lights.frame < 0 ? prior : lit).resolve(lights),
    onProbes: tracked.resolve,
    onProblem: (error) => problems.push(error),
  });
  stream.track("table", [0, -0.5, -0.5]);
  assert.deepEqual(await tracked.promise, { table: [0, -0.5, -0.5] });
  stream.subscribe([{ format: "sh" }, { format: "cube", size: 16 }]);
  assert.equal((await prior.promise).results[0]!.coverage, 0); // sent at once, before the first frame
  assert.equal((await stream.push(roomFrame(0))).status, "processed");
  const [table] = (await lit.promise).results;
  assert.deepEqual([table!.name, table!.forms.length, table!.forms[1]!.data!.length], ["table", 2, 6 * 16 * 16 * 8]);
  const requested = await stream.light({ probes: [{ name: "table" }], forms: [{ format: "main_light" }] });
  assert.equal(requested.results[0]!.etag, table!.etag);

  const first = await session.probe("table", { format: "cube", size: 16 });
  assert.deepEqual(first!.form.data, table!.forms[1]!.data);
  assert.equal(await session.probe("table", { format: "cube", size: 16 }, { etag: first!.etag }), null);
  assert.ok(Math.abs(first!.coverage - table!.coverage) < 1e-4);
  await session.track("table", [0.1, -0.5, -0.5]);
  assert.ok(await session.probe("table", { format: "cube", size: 16 }, { etag: first!.etag }));
  await session.untrack("table");

  stream.untrack("table");
  await assert.rejects(stream.light({ probes: [{ name: "table" }], forms: [{ format: "sh" }] }), RoomLightError);
  assert.equal(problems.length, 2);
  stream.close();
  await session.delete();
});

test("refusals name the field, and other tokens are refused", async () => {
  const session = await server.open(options);
  const scaled = { ...roomFrame(0), camera_to_world: [2, ...Array.from(roomFrame(0).camera_to_world).slice(1)] };
  await assert.rejects(session.push(scaled), (error) => {
    assert.ok(error instanceof RoomLightError);
    assert.deepEqual([error.status, error.problem!.field], [422, "camera_to_world"]);
    return true;
  });
  await session.push(roomFrame(3));
  await assert.rejects(session.push(roomFrame(2)), (error) => error instanceof RoomLightError && error.status === 409);
  const other = new RoomLight(process.env["ROOMLIGHT_SERVER"]!, { token: "not-a-token-of-this-server" });
  await assert.rejects(other.open(options), (error) => error instanceof RoomLightError && error.status === 401);
  await session.delete();
});

test("a session is joined with its index, and a 409 names the option", async () => {
  const session = await server.open(options);
  await session.push(roomFrame(4));
  const joined = await server.join(session.id);
  assert.deepEqual([joined.id, joined.model, joined.nextIndex], [session.id, "classical", 5]);
  const again = await server.open({ ...options, id: session.id });
  assert.equal(again.nextIndex, 5);
  await assert.rejects(server.open({ ...options, height: 64, id: session.id }), (error) => {
    assert.ok(error instanceof RoomLightError);
    assert.deepEqual([error.status, error.kind], [409, "session-conflict"]);
    assert.match(error.field, /height/);
    assert.match(error.message, /height.*32/s);
    return true;
  });
  await joined.delete();
  await assert.rejects(server.join(session.id), (error) => error instanceof RoomLightError && error.status === 404);
});
