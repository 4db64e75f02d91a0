// Scenes compared with three.js's own mathematics: probes, lights and texture lookups.

import assert from "node:assert/strict";
import { test } from "node:test";
import { findForm, type LightData, type Vector } from "roomlight";
import { applyToScene, environmentTexture, removeFromScene, specularTexture } from "roomlight/three";
import { CubeTexture, DataTexture, DirectionalLight, LightProbe, Scene, Texture, Vector3 } from "three";
import { HDRLoader } from "three/addons/loaders/HDRLoader.js";
import * as field from "./light_field.js";

const vector = (of: Vector) => new Vector3(...of);
const close = (actual: Vector3, wanted: readonly number[], within: number) =>
  assert.ok(actual.distanceTo(new Vector3(...wanted)) <= within, `${actual.toArray()} is not ${wanted}`);
const CUBE = field.binary("cube", field.cubeBytes(16));
const HDR = field.binary("hdr", field.hdrBytes(16, true));

test("a LightProbe shades like the light, in every basis", () => {
  for (const basis of ["arcore", "arkit", "threejs"] as const) {
    const { probe } = applyToScene(new Scene(), field.light([field.harmonicsForm(basis)]));
    for (const direction of field.DIRECTIONS) {
      close(probe.sh.getAt(vector(direction), new Vector3()), field.radiance(direction), 1e-5);
      const wanted = direction.map((part) => Math.PI * 0.5 + ((2 * Math.PI) / 3) * 0.4 * part);
      close(probe.sh.getIrradianceAt(vector(direction), new Vector3()), wanted, 1e-5);
    }
    assert.equal(probe.intensity, 1);
  }
});

test("harmonics and main light are not counted twice", () => {
  const [direction, intensity] = [field.MAIN_LIGHT.values!["direction"] as Vector, [3, 2, 1]];
  for (const kind of ["total", "ambient"] as const) {
    const { probe, directional } = applyToScene(
      new Scene(),
      field.light([field.harmonicsForm("threejs", kind), field.MAIN_LIGHT]),
    );
    const mean = probe.sh.coefficients[0]!.clone().multiplyScalar(Math.sqrt(4 * Math.PI)); // over the sphere
    close(
      mean,
      intensity.map((value) => 4 * Math.PI * 0.5 - (kind === "total" ? value : 0)),
      1e-5,
    );
    const shed = new Vector3(...directional.color.toArray()).multiplyScalar(directional.intensity);
    close(shed, intensity, 1e-6);
    const toward = directional.position.clone().sub(directional.target.position);
    close(toward.clone().normalize(), direction, 1e-12);
    close(directional.target.position, [1, 2, 3], 0);
    assert.ok(Math.abs(toward.length() - 5) < 1e-12);
  }
});

/** Sample like three.js's shaders: negate x, then OpenGL's face and texel. */
function sample(texture: CubeTexture, [x, y, z]: Vector, level = 0): number[] {
  const images = (
    level === 0 ? texture.images : (texture.mipmaps as unknown as CubeTexture[])[level - 1]!.images
  ) as DataTexture[];
  const side = images[0]!.image.width;
  const { face, row, column } = field.faceOf([-x, y, z], side);
  const texels = images[face]!.image.data as unknown as Uint16Array;
  return Array.from(texels.subarray((row * side + column) * 4).slice(0, 4), field.fromHalf);
}

test("a cube texture shows each direction's light", () => {
  for (const form of [CUBE, field.binary("ktx2", field.ktx2Bytes([field.cubeBytes(16)], 16))]) {
    const texture = environmentTexture(form) as CubeTexture;
    assert.ok(texture.isCubeTexture && !texture.isRenderTargetTexture && !texture.flipY && texture.version > 0);
    for (const direction of field.DIRECTIONS) {
      const [red, green, blue, alpha] = sample(texture, direction) as [number, number, number, number];
      close(new Vector3(red, green, blue), field.radiance(direction), 0.4 * (3 / 16));
      assert.equal(alpha, 1);
    }
  }
});

test("specular mips are a cube texture with levels", () => {
  const levels = [field.cubeBytes(8), field.cubeBytes(4, 0.5), field.cubeBytes(2, 0.25)];
  const texture = specularTexture(field.binary("specular", field.ktx2Bytes(levels, 8)));
  assert.equal(texture.mipmaps!.length, 2);
  for (const [level, gain] of [1, 0.5, 0.25].entries()) {
    const [red] = sample(texture, [1, 0, 0], level);
    assert.ok(Math.abs(red! - 0.9 * gain) < 0.1 * gain);
  }
});

test("a panorama shows each direction's light, like three.js's loader", () => {
  const texture = environmentTexture(HDR) as DataTexture;
  const { width, height, data } = texture.image as unknown as { width: number; height: number; data: Uint16Array };
  for (const [x, y, z] of field.DIRECTIONS) {
    const u = Math.atan2(z, x) / (2 * Math.PI) + 0.5; // three.js's equirectUv; v counts from the data's first row
    const v = Math.asin(Math.min(Math.max(y, -1), 1)) / Math.PI + 0.5;
    const [column, row] = [Math.min(Math.floor(u * width), width - 1), Math.min(Math.floor(v * height), height - 1)];
    const texel = Array.from(data.subarray((row * width + column) * 4).slice(0, 3), field.fromHalf);
    close(new Vector3(...texel), field.radiance([x, y, z]), 0.4 * (5 / 16));
  }
  const loaded = new HDRLoader().parse(HDR.data!.buffer) as unknown as { data: Uint16Array };
  for (let row = 0; row < height; row++) {
    const [ours, wanted] = [data.subarray(row * width * 4), loaded.data.subarray((height - 1 - row) * width * 4)].map(
      (from) => Array.from(from.slice(0, width * 4), field.fromHalf),
    );
    // three.js's loader divides the mantissa by 255, Radiance's own writer and the server by 256: 0.4 % difference.
    ours!.forEach((value, at) => assert.ok(Math.abs(value - wanted![at]!) <= wanted![at]! / 250));
  }
});

test("an environment replaces other lights, and equal light is kept", () => {
  const scene = new Scene();
  const full = field.light([CUBE, field.harmonicsForm("arcore"), field.MAIN_LIGHT]);
  const { probe, directional, environment } = applyToScene(scene, full, { intensity: 2, distance_m: 3 });
  assert.equal(scene.environment, environment);
  assert.deepEqual([scene.environmentIntensity, probe.intensity, directional.intensity], [2, 0, 0]);
  assert.equal(directional.position.distanceTo(directional.target.position).toFixed(6), "3.000000");
  assert.equal(applyToScene(scene, { ...full }, { intensity: 2, distance_m: 3 }).environment, environment);

  const other = new Scene();
  for (const [x, kind] of (["total", "ambient"] as const).entries()) {
    const forms = [field.harmonicsForm("arcore", kind), field.MAIN_LIGHT];
    const moved = { ...field.light(forms), position: [x, 0, 0] as Vector };
    const seen = applyToScene(other, moved);
    assert.deepEqual(seen.directional.target.position.toArray(), moved.position);
    assert.deepEqual(seen.probe.sh, applyToScene(new Scene(), moved).probe.sh);
  }

  let disposed = 0;
  environment!.addEventListener("dispose", () => disposed++);
  const next = applyToScene(scene, { ...full, etag: "b" });
  assert.notEqual(next.environment, environment);
  assert.deepEqual([disposed, next.probe, scene.children.length], [1, probe, 3]);

  const without = applyToScene(scene, field.light([field.harmonicsForm("arcore"), field.MAIN_LIGHT], "c"), {
    intensity: 2,
  });
  assert.deepEqual([scene.environment, scene.environmentIntensity], [null, 1]);
  assert.deepEqual([without.probe.intensity, without.directional.intensity], [2, 6]);
  assert.equal(without.directional.shadow.intensity, 1);
  assert.equal(applyToScene(scene, field.light([], "d")).directional.intensity, 0);
  assert.deepEqual(probe.sh.coefficients[0]!.toArray(), [0, 0, 0]);
});

test("with an environment a shadow is as strong as on the ground", () => {
  for (const [y, shadow_strength, wanted] of [
    [1, 0.4, 0.4],
    [0.6, 0.5, 0.375],
    [0.6, 1, 1],
    [0, 1, 0],
    [-0.6, 0.5, 0],
  ] as const) {
    const values = { direction: [Math.sqrt(1 - y * y), y, 0], intensity: [1, 1, 1], shadow_strength };
    const { directional } = applyToScene(new Scene(), field.light([CUBE, { ...field.MAIN_LIGHT, values }]));
    assert.equal(directional.shadow.intensity.toFixed(6), wanted.toFixed(6), `y ${y}, strength ${shadow_strength}`);
  }
});

test("the app's own environment is kept", () => {
  const scene = new Scene();
  scene.environmentIntensity = 2;
  applyToScene(scene, field.light([field.harmonicsForm("arkit")]), { intensity: 0.5 });
  assert.equal(scene.environmentIntensity, 2);
  const own = (scene.environment = new Texture());
  applyToScene(scene, field.light([field.harmonicsForm("arkit")], "a"));
  assert.deepEqual([scene.environment, scene.environmentIntensity], [own, 2]);
  applyToScene(scene, field.light([HDR], "b"), { intensity: 0.5 });
  assert.notEqual(scene.environment, own);
  removeFromScene(scene);
  assert.deepEqual([scene.environment, scene.environmentIntensity, scene.children], [null, 1, []]);
  removeFromScene(scene);
  const { probe, directional } = applyToScene(scene, field.light([HDR], "b"));
  assert.ok(probe instanceof LightProbe && directional instanceof DirectionalLight && scene.environment);
});

test("other forms make no environment", () => {
  assert.throws(
    () => environmentTexture(findForm(field.light([field.MAIN_LIGHT]), "main_light") as LightData),
    RangeError,
  );
  assert.throws(() => environmentTexture(field.binary("exr", new Uint8Array(8))), /got exr/);
});
