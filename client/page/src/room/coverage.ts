// What the stream has seen and what is filled: a tint of the mesh where few frames looked, and behind the mesh, on the
// walls of the volume's box, the light that is filled in at the selected probe because no frame has seen it.

import type { CameraView } from "roomlight";
import {
  BackSide,
  BoxGeometry,
  BufferAttribute,
  Color,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  ShaderMaterial,
  Vector3,
  type Scene,
  type Texture,
} from "three";
import type { ProbeLight } from "../state";

const CAMERAS = 24; // of the path, evenly chosen
const OFTEN = 6; // cameras that see a vertex: no tint
const MOST_TINT = 0.5; // of the mesh, where one camera looked
const FILLED_TINT = 0.6;

const SHELL_VERTEX = /* glsl */ `
  varying vec3 worldPosition;
  void main() {
    vec4 world = modelMatrix * vec4(position, 1.0);
    worldPosition = world.xyz;
    gl_Position = projectionMatrix * viewMatrix * world;
  }`;

const SHELL_FRAGMENT = /* glsl */ `
  uniform sampler2D panorama;
  uniform vec3 probe;
  uniform float gain;
  uniform vec3 accent;
  varying vec3 worldPosition;
  void main() {
    vec3 to = normalize(worldPosition - probe);
    vec2 at = vec2(0.5 + atan(to.z, to.x) / 6.28318531, acos(clamp(to.y, -1.0, 1.0)) / 3.14159265);
    vec4 texel = texture2D(panorama, at);
    if (texel.a > 0.5) discard; // seen: the mesh shows it at its distance
    gl_FragColor = vec4(mix(min(texel.rgb * gain, 1.0), accent, ${FILLED_TINT} * (1.0 - texel.a)), 1.0);
    #include <colorspace_fragment>
  }`;

export class RoomCoverage {
  private readonly accent = new Color();
  private readonly tint = { value: 0 };
  private readonly shell: Mesh<BoxGeometry, ShaderMaterial>;
  private box = "";

  constructor(scene: Scene) {
    const uniforms = { panorama: { value: null }, probe: { value: new Vector3() }, gain: { value: 1 }, accent: { value: this.accent } };
    const material = new ShaderMaterial({ vertexShader: SHELL_VERTEX, fragmentShader: SHELL_FRAGMENT, uniforms, side: BackSide });
    material.depthWrite = material.depthTest = false;
    this.shell = new Mesh(new BoxGeometry(), material);
    this.shell.renderOrder = -1;
    this.shell.matrixAutoUpdate = false;
    this.shell.visible = false;
    scene.add(this.shell);
  }

  /** Let the material of a room's mesh show the tint. */
  paint(material: MeshBasicMaterial): void {
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, { coverageTint: this.tint, coverageAccent: { value: this.accent } });
      shader.vertexShader = shader.vertexShader
        .replace("void main() {", "attribute float unseen;\nvarying float vUnseen;\nvoid main() {\nvUnseen = unseen;");
      shader.fragmentShader = shader.fragmentShader
        .replace("void main() {", "uniform float coverageTint;\nuniform vec3 coverageAccent;\nvarying float vUnseen;\nvoid main() {")
        .replace("#include <opaque_fragment>", "outgoingLight = mix(outgoingLight, coverageAccent, coverageTint * vUnseen);\n#include <opaque_fragment>");
    };
  }

  /** Show or hide the tint and the filled walls. */
  show(on: boolean, accent: string, gain: number): void {
    this.tint.value = on ? 1 : 0;
    this.accent.setStyle(accent);
    this.shell.material.uniforms["gain"]!.value = gain;
    this.shell.visible = on && this.box !== "" && this.shell.material.uniforms["panorama"]!.value !== null;
  }

  /** The light behind the mesh: a probe's panorama, as its sphere shows it. */
  light(probe: ProbeLight | null, panorama: Texture | null): void {
    const { uniforms } = this.shell.material;
    uniforms["panorama"]!.value = probe ? panorama : null;
    (uniforms["probe"]!.value as Vector3).set(...(probe?.position ?? ([0, 0, 0] as const)));
  }

  /** The walls of the volume. */
  walls(volume: CameraView["volume"]): void {
    const key = volume ? JSON.stringify(volume) : "";
    if (volume && key !== this.box) {
      const [lower, upper] = [new Vector3(...volume.lower_m), new Vector3(...volume.upper_m)];
      const size = upper.clone().sub(lower);
      const middle = lower.add(upper).multiplyScalar(0.5);
      this.shell.matrix
        .fromArray([...volume.volume_to_world])
        .multiply(new Matrix4().makeTranslation(middle.x, middle.y, middle.z))
        .scale(size);
    }
    this.box = key;
  }
}

/** Store for each vertex of a mesh how much of the tint it gets: none where many cameras of the path looked. */
export function markSeldomSeen(mesh: Mesh, camera: CameraView | null): void {
  const positions = mesh.geometry.getAttribute("position").array;
  const unseen = new Float32Array(positions.length / 3);
  const views = viewsOf(camera);
  for (let vertex = 0; vertex < unseen.length; vertex++) {
    const [x, y, z] = [positions[3 * vertex]!, positions[3 * vertex + 1]!, positions[3 * vertex + 2]!];
    const count = views.reduce((sum, sees) => sum + (sees(x, y, z) ? 1 : 0), 0);
    const often = Math.min(1, Math.max(0, count - 1) / (Math.min(OFTEN, Math.max(2, views.length)) - 1));
    unseen[vertex] = MOST_TINT * (1 - often);
  }
  mesh.geometry.setAttribute("unseen", new BufferAttribute(unseen, 1));
}

/** Whether a point is in the picture of a camera, for some cameras of the path; what stands in between is left out. */
function viewsOf(camera: CameraView | null): ((x: number, y: number, z: number) => boolean)[] {
  const { path = [], intrinsics } = camera ?? {};
  if (!intrinsics) {
    return [];
  }
  const { fx, fy, cx, cy, width, height } = intrinsics;
  const count = Math.min(CAMERAS, path.length);
  return Array.from({ length: count }, (_, at) => {
    const pose = path[Math.floor(((at + 0.5) * path.length) / count)]!.camera_to_world;
    const [m0, m1, m2, , m4, m5, m6, , m8, m9, m10, , tx, ty, tz] = pose as unknown as [
      ...[number, number, number, number, number, number, number, number],
      ...[number, number, number, number, number, number, number],
    ];
    return (x: number, y: number, z: number) => {
      const [dx, dy, dz] = [x - tx, y - ty, z - tz];
      const ahead = -(m8 * dx + m9 * dy + m10 * dz);
      const column = cx * ahead + fx * (m0 * dx + m1 * dy + m2 * dz);
      const row = cy * ahead - fy * (m4 * dx + m5 * dy + m6 * dz);
      return ahead > 0.05 && column > 0 && column < width * ahead && row > 0 && row < height * ahead;
    };
  });
}
