// Light into a three.js scene. Signs, units and handedness are three.js's after this, and nothing is counted twice:
// materials take the environment's light for both their diffuse and their specular part, so that harmonics and main
// light beside an environment would light them again.

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
import { cubeOf } from "./cube.js";
import { Harmonics, type HarmonicsValues, type MainLightValues } from "./harmonics.js";
import { parseHdr } from "./hdr.js";
import { formOf, type Light, type LightData } from "./light.js";

/** What `applyToScene` keeps in a scene; use `directional` for shadows. */
export interface SceneLights {
  probe: LightProbe;
  directional: DirectionalLight;
  environment: Texture | null;
}

export interface ApplyOptions {
  /** Multiplies all of the light: 1 shows radiance 1.0 as white without tone mapping. */
  intensity?: number;
  /** How far from the probe the directional light stands, for its shadow camera: 5 m. */
  distance_m?: number;
}

const scenes = new WeakMap<Scene, SceneLights & { shown: string }>();
const HALF_ONE = 0x3c00;
const LIGHTS = { cube: cubeTexture, ktx2: cubeTexture, hdr: equirectTexture } as const;

/**
 * Light a scene with the forms that the light has, and again with each newer light.
 *
 * - `cube`, `ktx2` or `hdr`: `scene.environment`, which lights everything. The directional light of a `main_light` is
 *   then of intensity 0: it casts its shadow on a `ShadowMaterial` and sheds no light a second time.
 * - else `sh`: a `LightProbe`, and with `main_light` a `DirectionalLight` that is taken out of the harmonics.
 *
 * The same light again (by its ETag) costs nothing. What an earlier light put there and this one lacks is removed.
 */
export function applyToScene(scene: Scene, light: Light, options: ApplyOptions = {}): SceneLights {
  const { intensity = 1, distance_m = 5 } = options;
  const lights = scenes.get(scene) ?? prepare(scene);
  const shown = `${light.etag} ${light.forms.map((form) => form.format)} ${intensity} ${distance_m}`;
  if (shown === lights.shown) {
    return lights;
  }
  const form = formOf(light, "cube", "ktx2", "hdr");
  const environment = form ? environmentTexture(form) : null;
  if (environment || scene.environment === lights.environment) {
    scene.environment = environment; // with none to set, the app's own stays
    scene.environmentIntensity = intensity;
  }
  lights.environment?.dispose();
  lights.environment = environment;

  const main = formOf(light, "main_light")?.values as unknown as MainLightValues | undefined;
  setDirectional(lights.directional, light, main, distance_m);
  setProbe(lights.probe, light, main);
  lights.directional.intensity *= environment ? 0 : intensity;
  lights.probe.intensity = environment ? 0 : intensity;
  lights.shown = shown;
  return lights;
}

/** Take out of a scene what `applyToScene` put there, and free it. */
export function removeFromScene(scene: Scene): void {
  const lights = scenes.get(scene);
  if (lights) {
    scene.remove(lights.probe, lights.directional, lights.directional.target);
    if (scene.environment === lights.environment) {
      scene.environment = null;
    }
    lights.environment?.dispose();
    lights.directional.dispose();
    scenes.delete(scene);
  }
}

/** A texture for `scene.environment`, `scene.background` or a material's `envMap`, of a form cube, ktx2 or hdr. */
export function environmentTexture(form: LightData): CubeTexture | DataTexture {
  const make = LIGHTS[form.format as keyof typeof LIGHTS] as
    ((form: LightData) => CubeTexture | DataTexture) | undefined;
  if (!make) {
    throw new RangeError(`an environment is made of cube, ktx2 or hdr, not of ${form.format}`);
  }
  return make(form);
}

/**
 * The prefiltered mips of a form `specular` as a cube texture, for shaders of one's own (`textureLod`). three.js's own
 * materials filter for themselves: give them a `cube`.
 */
export function specularTexture(form: LightData): CubeTexture {
  return cubeTexture(form);
}

function prepare(scene: Scene): SceneLights & { shown: string } {
  const lights = { probe: new LightProbe(), directional: new DirectionalLight(), environment: null, shown: "" };
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
  // Its intensity is irradiance in three.js too: a surface of albedo a that faces it gives back a / pi of it.
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

function setProbe(probe: LightProbe, light: Light, main: MainLightValues | undefined): void {
  const form = formOf(light, "sh");
  if (!form) {
    probe.sh.zero();
    return;
  }
  const all = Harmonics.of(form);
  const isTotal = (form.values as unknown as HarmonicsValues).kind === "total";
  // three.js convolves with the cosine itself: a LightProbe holds radiance.
  const { coefficients } = main && isTotal ? all.without(main.direction, main.intensity) : all;
  probe.sh.fromArray(coefficients.flat());
}

/**
 * three.js looks a direction up in a cube texture with x negated, and WebGPU's renderer does so even for those that
 * have `isRenderTargetTexture`. So the cube is mirrored here: -X's faces stand for +X, and rows run the other way.
 */
function cubeTexture(form: LightData): CubeTexture {
  const cube = cubeOf(form);
  const [base, ...mips] = cube.levels.map((faces, level) => {
    const side = Math.max(cube.size >> level, 1);
    const images = [1, 0, 2, 3, 4, 5].map((face) => faceTexture(faces[face]!, side));
    return configured(new CubeTexture(images));
  }) as [CubeTexture, ...CubeTexture[]];
  base.mipmaps = mips as never[]; // three.js's uploads of uncompressed cubes take levels 1.. from here
  base.minFilter = mips.length > 0 ? LinearMipmapLinearFilter : LinearFilter;
  base.needsUpdate = true;
  return base;
}

function faceTexture(face: Uint16Array<ArrayBuffer>, side: number): DataTexture {
  const mirrored = new Uint16Array(face.length);
  for (let texel = 0; texel < side * side; texel++) {
    const from = 4 * (texel - (texel % side) + side - 1 - (texel % side));
    mirrored.set(face.subarray(from, from + 3), 4 * texel);
    mirrored[4 * texel + 3] = HALF_ONE; // alpha says how far the texel was observed; it is no transparency
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
      const to = ((height - 1 - row) * width + column) * 4; // a texture's first row is its lowest
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
