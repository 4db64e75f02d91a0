// Light a three.js scene. The results have three.js's signs, units and handedness. No light is counted twice: an
// environment already contributes to both the diffuse and the specular part of materials, so harmonics and main light
// do not contribute next to one.

import {
  Color,
  CubeTexture,
  DataTexture,
  DataUtils,
  DirectionalLight,
  EquirectangularReflectionMapping,
  HalfFloatType,
  LightProbe,
  LinearFilter,
  LinearMipmapLinearFilter,
  LinearSRGBColorSpace,
  RGBAFormat,
  RepeatWrapping,
  type Scene,
  type Texture,
} from "three";
import { parseCube } from "./cube.js";
import { Harmonics, type HarmonicsValues, type MainLightValues } from "./harmonics.js";
import { parseHdr } from "./hdr.js";
import { findForm, findFormFor, type Light, type LightData } from "./light.js";

/** The objects that `applyToScene` adds to a scene; use `directional` for shadows. */
export interface SceneLights {
  probe: LightProbe;
  directional: DirectionalLight;
  environment: Texture | null;
}

export interface ApplyOptions {
  /** Factor for all light; with 1 and without tone mapping, radiance 1.0 is white. */
  intensity?: number | undefined;
  /** Distance of the directional light from the probe, for its shadow camera; default 5 m. */
  distance_m?: number | undefined;
}

const scenes = new WeakMap<Scene, SceneLights & { appliedKey: string }>();
const HALF_ONE = 0x3c00; // 1.0 as float16
const TEXTURE_MAKERS = { cube: cubeTexture, ktx2: cubeTexture, hdr: equirectTexture } as const;

/**
 * Light a scene with the forms of a light. Call it again with each newer light.
 *
 * - `cube`, `ktx2` or `hdr` (of the use lighting): sets `scene.environment`, which lights everything. The directional light of a `main_light`
 *   then has intensity 0: it only casts its shadow, on a horizontal `ShadowMaterial`, as strong as it is on the ground.
 * - otherwise `sh`: a `LightProbe`; with `main_light` also a `DirectionalLight`, subtracted from the harmonics.
 *
 * Returns at once if the light is the same: its ETag, point and forms. Removes what an earlier light set and this one lacks.
 */
export function applyToScene(scene: Scene, light: Light, options: ApplyOptions = {}): SceneLights {
  const { intensity = 1, distance_m = 5 } = options;
  const lights = scenes.get(scene) ?? addLights(scene);
  const forms = light.forms.map(({ data, ...form }) => ({ ...form, bytes: data?.length }));
  const key = JSON.stringify([light.etag, light.position, forms, intensity, distance_m]);
  if (key === lights.appliedKey) {
    return lights;
  }
  const form = findFormFor("lighting", light, "cube", "ktx2", "hdr");
  const environment = form ? environmentTexture(form) : null;
  removeEnvironment(scene, lights);
  if (environment) {
    scene.environment = environment; // without one, the app's own environment stays
    scene.environmentIntensity = intensity;
  }
  lights.environment = environment;

  const main = findForm(light, "main_light")?.values as unknown as MainLightValues | undefined;
  setDirectional(lights.directional, light, main, distance_m);
  setProbe(lights.probe, light, main);
  lights.directional.intensity *= environment ? 0 : intensity;
  // Without an environment a shadow is as strong as the light; with one it is drawn by a ShadowMaterial.
  lights.directional.shadow.intensity = environment && main ? shadowOnGround(main) : 1;
  lights.probe.intensity = environment ? 0 : intensity;
  lights.appliedKey = key;
  return lights;
}

/** Remove the objects of `applyToScene` from a scene and dispose of them. */
export function removeFromScene(scene: Scene): void {
  const lights = scenes.get(scene);
  if (lights) {
    scene.remove(lights.probe, lights.directional, lights.directional.target);
    removeEnvironment(scene, lights);
    lights.directional.dispose();
    scenes.delete(scene);
  }
}

function removeEnvironment(scene: Scene, { environment }: SceneLights): void {
  if (environment && scene.environment === environment) {
    scene.environment = null;
    scene.environmentIntensity = 1;
  }
  environment?.dispose();
}

/** A texture of a form cube, ktx2 or hdr, for `scene.environment`, `scene.background` or a material's `envMap`. */
export function environmentTexture(form: LightData): CubeTexture | DataTexture {
  const make = TEXTURE_MAKERS[form.format as keyof typeof TEXTURE_MAKERS] as
    ((form: LightData) => CubeTexture | DataTexture) | undefined;
  if (!make) {
    throw new RangeError(`an environment texture needs a form cube, ktx2 or hdr, got ${form.format}`);
  }
  return make(form);
}

/**
 * The prefiltered mips of a form `specular` as a cube texture, for custom shaders (`textureLod`). three.js's materials
 * do their own filtering: use a form `cube` for them.
 */
export function specularTexture(form: LightData): CubeTexture {
  return cubeTexture(form);
}

function addLights(scene: Scene): SceneLights & { appliedKey: string } {
  const lights = { probe: new LightProbe(), directional: new DirectionalLight(), environment: null, appliedKey: "" };
  scene.add(lights.probe, lights.directional, lights.directional.target);
  scenes.set(scene, lights);
  return lights;
}

function setDirectional(
  directional: DirectionalLight,
  light: Light,
  main: MainLightValues | undefined,
  distance_m: number,
): void {
  const [red, green, blue] = main?.intensity ?? [0, 0, 0];
  const strongest = Math.max(red, green, blue);
  // In three.js, too, the intensity is an irradiance: a facing surface of albedo a reflects the radiance a / pi of it.
  directional.intensity = strongest;
  directional.color = new Color().setRGB(
    red / (strongest || 1),
    green / (strongest || 1),
    blue / (strongest || 1),
    LinearSRGBColorSpace,
  );
  directional.target.position.set(...light.position);
  directional.position.set(...(main?.direction ?? ([0, 1, 0] as const)));
  directional.position.multiplyScalar(distance_m).add(directional.target.position);
}

/** The light's share of the irradiance on the ground, with other light as strong there as on a surface that faces it. */
function shadowOnGround({ direction, shadow_strength }: MainLightValues): number {
  const share = Math.max(direction[1], 0) * shadow_strength;
  return share && share / (share + 1 - shadow_strength);
}

function setProbe(probe: LightProbe, light: Light, main: MainLightValues | undefined): void {
  const form = findForm(light, "sh");
  if (!form) {
    probe.sh.zero();
    return;
  }
  const all = Harmonics.of(form);
  const isTotal = (form.values as unknown as HarmonicsValues).kind === "total";
  // A LightProbe stores radiance; three.js convolves it with the cosine lobe.
  const { coefficients } = main && isTotal ? all.without(main.direction, main.intensity) : all;
  probe.sh.fromArray(coefficients.flat());
}

/**
 * Make a mirrored cube texture: three.js negates x when it samples a cube texture (its WebGPU renderer even those with
 * `isRenderTargetTexture`). So the faces +X and -X are swapped, and the texels of each row are reversed.
 */
function cubeTexture(form: LightData): CubeTexture {
  const cube = parseCube(form);
  const [base, ...mips] = cube.levels.map((faces, level) => {
    const side = Math.max(cube.size >> level, 1);
    const images = [1, 0, 2, 3, 4, 5].map((face) => faceTexture(faces[face]!, side));
    return configured(new CubeTexture(images));
  }) as [CubeTexture, ...CubeTexture[]];
  base.mipmaps = mips as never[]; // three.js uploads levels 1 and above of uncompressed cubes from here
  base.minFilter = mips.length > 0 ? LinearMipmapLinearFilter : LinearFilter;
  base.needsUpdate = true;
  return base;
}

function faceTexture(face: Uint16Array<ArrayBuffer>, side: number): DataTexture {
  const mirrored = new Uint16Array(face.length);
  for (let texel = 0; texel < side * side; texel++) {
    const from = 4 * (texel - (texel % side) + side - 1 - (texel % side));
    mirrored.set(face.subarray(from, from + 3), 4 * texel);
    mirrored[4 * texel + 3] = HALF_ONE; // the server's alpha is how well the texel was observed, not transparency
  }
  const texture = new DataTexture(mirrored, side, side, RGBAFormat, HalfFloatType);
  texture.needsUpdate = true;
  return texture;
}

function equirectTexture(form: LightData): DataTexture {
  const { width, height, rgb } = parseHdr(form.data ?? new Uint8Array());
  const texels = new Uint16Array(width * height * 4).fill(HALF_ONE);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const to = ((height - 1 - row) * width + column) * 4; // the first row of a texture is the lowest one
      for (let channel = 0; channel < 3; channel++) {
        texels[to + channel] = DataUtils.toHalfFloat(Math.min(rgb[(row * width + column) * 3 + channel]!, 65504));
      }
    }
  }
  const texture = configured(new DataTexture(texels, width, height));
  texture.mapping = EquirectangularReflectionMapping;
  texture.wrapS = RepeatWrapping;
  texture.needsUpdate = true;
  return texture;
}

function configured<T extends Texture>(texture: T): T {
  texture.format = RGBAFormat;
  texture.type = HalfFloatType;
  texture.colorSpace = LinearSRGBColorSpace;
  texture.minFilter = LinearFilter;
  texture.magFilter = LinearFilter;
  texture.generateMipmaps = false;
  texture.flipY = false;
  return texture;
}
