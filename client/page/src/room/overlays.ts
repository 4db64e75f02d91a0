// What is drawn over the room: the camera and its path, the box of the volume, main lights as arrows.

import {
  BackSide,
  BoxGeometry,
  BufferGeometry,
  ConeGeometry,
  CylinderGeometry,
  EdgesGeometry,
  Group,
  Line,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  Quaternion,
  Vector3,
} from "three";
import type { CameraView, LightSourceValues } from "roomlight";
import { onThemeChange, themeColour } from "../lib/dom";
import { timed } from "../lib/parts";
import { hueOf, strengthOf } from "../lib/tone";
import type { State } from "../state";
import type { RoomView } from "./view";

const FRUSTUM_M = 0.28;
const ARROW_M = 0.75; // of the strongest light
const UP = new Vector3(0, 1, 0);
const IDENTITY = new Matrix4().elements;
const SHAFT = new CylinderGeometry(1, 1, 1, 12);
const HEAD = new ConeGeometry(1, 1, 20);
const OUTLINE = new MeshBasicMaterial({ color: 0x1d1c19, side: BackSide });

export class RoomOverlays {
  readonly path = new Group();
  readonly volume = new Group();
  readonly lights = new Group();
  private shown = { path: "", intrinsics: "", volume: "" };
  private line: Line | null = null;
  private camera: LineSegments | null = null;
  private readonly paints: MeshBasicMaterial[] = []; // of the arrows; three.js compiles a shader for each new one
  private readonly lines = new LineBasicMaterial();
  private readonly faint = new LineBasicMaterial({ transparent: true, opacity: 0.5 });

  constructor(
    private readonly view: RoomView,
    private readonly state: State,
  ) {
    view.scene.add(this.path, this.volume, this.lights);
    const recolour = () => {
      this.lines.color.setStyle(themeColour("--accent"));
      this.faint.color.setStyle(themeColour("--control-line"));
      view.drawSoon();
    };
    recolour();
    onThemeChange(recolour);
  }

  /** Show the camera: of the shown entry of the timeline, or the newest. */
  updateCamera(): void {
    timed("camera path", () => this.showCamera(this.state.camera.value));
    this.view.drawSoon();
  }

  private showCamera(camera: CameraView | null): void {
    const { path = [], intrinsics = null, volume = null } = camera ?? {};
    const ends = `${path.length} ${path[0]?.index} ${path.at(-1)?.index}`;
    if (this.changed("path", ends)) {
      this.line = replaced(this.path, this.line, path.length > 0 ? this.lineOf(path) : null);
    }
    if (this.changed("intrinsics", JSON.stringify(intrinsics))) {
      this.camera = replaced(this.path, this.camera, intrinsics ? this.frustum(intrinsics) : null);
    }
    if (this.changed("volume", JSON.stringify(volume))) {
      clear(this.volume);
      if (volume) {
        this.volume.add(this.box(volume));
      }
    }
    const isPast = this.state.shownEntry.value !== null;
    const past = isPast ? path.find(({ index }) => index === this.state.entry?.index) : undefined;
    const pose = past?.camera_to_world ?? camera?.camera_to_world;
    if (this.camera) {
      this.camera.visible = pose != null;
      this.camera.matrix.fromArray([...(pose ?? IDENTITY)]);
    }
  }

  private changed(what: keyof RoomOverlays["shown"], key: string): boolean {
    const isNew = this.shown[what] !== key;
    this.shown[what] = key;
    return isNew;
  }

  private lineOf(path: CameraView["path"]): Line {
    const points = path.map(({ camera_to_world: pose }) => new Vector3(pose[12], pose[13], pose[14]));
    return new Line(new BufferGeometry().setFromPoints(points), this.lines);
  }

  /** Show the main lights at the selected probe: arrows that end at it. */
  updateLights(): void {
    timed("light arrows", () => this.showLights());
    this.view.drawSoon();
  }

  private showLights(): void {
    clear(this.lights);
    const probe = this.state.probe;
    const strongest = Math.max(0, ...(probe?.lights ?? []).map(strengthOf));
    for (const [at, light] of (probe?.lights ?? []).entries()) {
      const length = ARROW_M * Math.sqrt(strengthOf(light) / (strongest || 1));
      if (length > 0.12) {
        const paint = (this.paints[at] ??= new MeshBasicMaterial());
        paint.color.setStyle(hueOf(light));
        this.lights.add(arrow(new Vector3(...probe!.position), light, length, paint));
      }
    }
  }

  private frustum({ fx, fy, cx, cy, width, height }: NonNullable<CameraView["intrinsics"]>): LineSegments {
    const corner = (u: number, v: number) =>
      new Vector3(((u - cx) / fx) * FRUSTUM_M, (-(v - cy) / fy) * FRUSTUM_M, -FRUSTUM_M);
    const corners = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
    const points = corners.flatMap((here, at) => [new Vector3(), here, here, corners[(at + 1) % 4]!]);
    const lines = new LineSegments(new BufferGeometry().setFromPoints(points), this.lines);
    lines.matrixAutoUpdate = false;
    lines.frustumCulled = false;
    return lines;
  }

  private box({ volume_to_world, lower_m, upper_m }: NonNullable<CameraView["volume"]>): LineSegments {
    const [lower, upper] = [new Vector3(...lower_m), new Vector3(...upper_m)];
    const size = upper.clone().sub(lower);
    const geometry = new BoxGeometry(size.x, size.y, size.z);
    const lines = new LineSegments(new EdgesGeometry(geometry), this.faint);
    geometry.dispose();
    lines.position.copy(lower.add(upper).multiplyScalar(0.5));
    lines.updateMatrix();
    lines.applyMatrix4(new Matrix4().fromArray([...volume_to_world]));
    return lines;
  }
}

/** An arrow that ends at the probe, with a dark outline so that it shows before bright walls. */
function arrow(probe: Vector3, light: LightSourceValues, length: number, paint: MeshBasicMaterial): Group {
  const group = new Group();
  const paints = [
    [paint, 0],
    [OUTLINE, 0.007],
  ] as const;
  for (const [material, outline] of paints) {
    const shaft = new Mesh(SHAFT, material);
    shaft.scale.set(0.014 + outline, length + 2 * outline, 0.014 + outline);
    shaft.position.y = 0.29 + length / 2;
    const head = new Mesh(HEAD, material);
    head.scale.set(0.05 + 1.6 * outline, 0.13 + 3 * outline, 0.05 + 1.6 * outline);
    head.rotation.x = Math.PI; // points at the probe
    head.position.y = 0.23;
    group.add(shaft, head);
  }
  group.position.copy(probe);
  group.setRotationFromQuaternion(new Quaternion().setFromUnitVectors(UP, new Vector3(...light.direction).normalize()));
  return group;
}

/** Take lines out of a group and put others in. */
function replaced<T extends Line>(group: Group, old: T | null, made: T | null): T | null {
  if (old) {
    group.remove(old);
    old.geometry.dispose();
  }
  if (made) {
    group.add(made);
  }
  return made;
}

/** Empty a group, and free its lines. */
function clear(group: Group): void {
  group.traverse((node) => node instanceof Line && node.geometry.dispose());
  group.clear();
}
