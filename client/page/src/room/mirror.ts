// A mirror that shows a panorama of linear radiance: u = 0.5 + atan2(z, x) / 2 pi, v = acos(y) / pi from the top row.

import {
  Color,
  DataTexture,
  DataUtils,
  HalfFloatType,
  LinearFilter,
  RGBAFormat,
  RepeatWrapping,
  ShaderMaterial,
  type Texture,
} from "three";
import type { ProbeLight } from "../state";

const HALF_MAX = 65504;

const VERTEX = /* glsl */ `
  varying vec3 worldNormal;
  varying vec3 worldPosition;
  void main() {
    vec4 world = modelMatrix * vec4(position, 1.0);
    worldPosition = world.xyz;
    worldNormal = mat3(modelMatrix) * normal;
    gl_Position = projectionMatrix * viewMatrix * world;
  }`;

const FRAGMENT = /* glsl */ `
  uniform sampler2D panorama;
  uniform float gain;
  uniform float tint;
  uniform float rim;
  uniform vec3 accent;
  varying vec3 worldNormal;
  varying vec3 worldPosition;
  void main() {
    vec3 normal = normalize(worldNormal);
    vec3 view = normalize(worldPosition - cameraPosition);
    vec3 seen = reflect(view, normal);
    vec2 at = vec2(0.5 + atan(seen.z, seen.x) / 6.28318531, acos(clamp(seen.y, -1.0, 1.0)) / 3.14159265);
    vec4 texel = texture2D(panorama, at);
    vec3 colour = texel.rgb * gain;
    colour = mix(colour, accent, tint * 0.6 * (1.0 - texel.a));
    float edge = smoothstep(0.34, 0.26, abs(dot(view, normal)));
    gl_FragColor = vec4(mix(colour, accent, rim * edge), 1.0);
    #include <colorspace_fragment>
  }`;

/** Material of a mirror sphere. */
export class MirrorMaterial extends ShaderMaterial {
  private shown: ProbeLight["panorama"] = null;

  constructor() {
    super({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        panorama: { value: texture(1, 1, new Uint16Array(4).fill(DataUtils.toHalfFloat(0.3))) },
        gain: { value: 1 },
        tint: { value: 0 },
        rim: { value: 0 },
        accent: { value: new Color() },
      },
    });
  }

  set(name: "gain" | "tint" | "rim", value: number): void {
    this.uniforms[name]!.value = value;
  }

  /** The panorama, with how well it was seen in alpha. */
  get texture(): Texture {
    return this.uniforms["panorama"]!.value as Texture;
  }

  set accent(colour: string) {
    (this.uniforms["accent"]!.value as Color).setStyle(colour);
  }

  /** Show the light of a probe. */
  show({ panorama, seen }: Pick<ProbeLight, "panorama" | "seen">): void {
    if (!panorama || panorama === this.shown) {
      return;
    }
    this.shown = panorama;
    const { width, height, rgb } = panorama;
    const texels = new Uint16Array(width * height * 4);
    const scale = seen && seen.length === width * height ? seen : null;
    for (let pixel = 0; pixel < width * height; pixel++) {
      for (let channel = 0; channel < 3; channel++) {
        texels[4 * pixel + channel] = DataUtils.toHalfFloat(Math.min(rgb[3 * pixel + channel]!, HALF_MAX));
      }
      texels[4 * pixel + 3] = DataUtils.toHalfFloat(scale ? scale[pixel]! / 255 : 1);
    }
    (this.uniforms["panorama"]!.value as DataTexture).dispose();
    this.uniforms["panorama"]!.value = texture(width, height, texels);
  }

  override dispose(): void {
    (this.uniforms["panorama"]!.value as DataTexture).dispose();
    super.dispose();
  }
}

function texture(width: number, height: number, texels: Uint16Array<ArrayBuffer>): DataTexture {
  const made = new DataTexture(texels, width, height, RGBAFormat, HalfFloatType);
  made.wrapS = RepeatWrapping;
  made.minFilter = made.magFilter = LinearFilter;
  made.needsUpdate = true;
  return made;
}
