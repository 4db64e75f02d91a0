// The probes as mirror spheres that one drags.

import { Mesh, Plane, SphereGeometry, Vector3, type Raycaster } from "three";
import type { Position } from "roomlight";
import { onThemeChange, themeColour } from "../lib/dom";
import type { State } from "../state";
import { MirrorMaterial } from "./mirror";
import type { RoomSurface } from "./surface";
import type { RoomView } from "./view";

export type DragMode = "level" | "height" | "surface";

const RADIUS_M = 0.12;
const UP = new Vector3(0, 1, 0);

interface DragEvents {
  /** How a drag moves a probe, without a modifier key. */
  mode: () => DragMode;
  onDrag: (name: string, position: Position) => void;
  onDrop: (name: string, position: Position) => void;
}

type Sphere = Mesh<SphereGeometry, MirrorMaterial>;

export class RoomProbes {
  readonly spheres = new Map<string, Sphere>();
  private readonly geometry: SphereGeometry;
  private drag: { sphere: Sphere; start: Vector3; grab: Vector3; moved: boolean; pointerId: number } | null = null;

  constructor(
    private readonly view: RoomView,
    private readonly surface: RoomSurface,
    private readonly state: State,
    private readonly canvas: HTMLCanvasElement,
    private readonly events: DragEvents,
  ) {
    const columns = view.isSoftware ? 24 : 48;
    this.geometry = new SphereGeometry(RADIUS_M, columns, (2 * columns) / 3);
    canvas.addEventListener("pointerdown", (event) => this.onDown(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.onMove(event));
    canvas.addEventListener("pointerup", (event) => this.onUp(event));
    canvas.addEventListener("pointercancel", (event) => this.onUp(event));
    onThemeChange(() => this.update());
  }

  /** Show the probes of the state. */
  update(): void {
    const { probes, selectedProbe, exposureEv, coverageTint } = this.state;
    for (const [name, sphere] of [...this.spheres]) {
      if (!probes.has(name)) {
        this.view.scene.remove(sphere);
        sphere.material.dispose();
        this.spheres.delete(name);
      }
    }
    const accent = themeColour("--accent");
    for (const [name, probe] of probes) {
      const { material, position } = this.sphereOf(name);
      position.set(...probe.position);
      material.show(probe);
      material.set("gain", 2 ** exposureEv.value);
      material.set("tint", coverageTint.value ? 1 : 0);
      material.set("rim", name === selectedProbe.value ? 1 : 0);
      material.accent = accent;
    }
    this.view.drawSoon();
  }

  /** The probe that a ray meets before any surface. */
  at(ray: Raycaster): string | null {
    const hit = ray.intersectObjects([...this.spheres.values()], false)[0];
    return hit?.object.name ?? null;
  }

  private sphereOf(name: string): Sphere {
    let sphere = this.spheres.get(name);
    if (!sphere) {
      sphere = new Mesh(this.geometry, new MirrorMaterial());
      sphere.name = name;
      this.spheres.set(name, sphere);
      this.view.scene.add(sphere);
    }
    return sphere;
  }

  private onDown(event: PointerEvent): void {
    const isOther = this.drag !== null && event.pointerId !== this.drag.pointerId; // a second finger
    if (event.button !== 0 || isOther || this.state.pastProbes.value) {
      return;
    }
    const ray = this.view.rayAt(event.clientX, event.clientY);
    const name = this.at(ray);
    const sphere = name === null ? undefined : this.spheres.get(name);
    if (!sphere) {
      return;
    }
    this.state.selectedProbe.value = sphere.name;
    const facing = new Plane().setFromNormalAndCoplanarPoint(ray.ray.direction, sphere.position);
    const grab = ray.ray.intersectPlane(facing, new Vector3()) ?? sphere.position.clone();
    this.drag = { sphere, start: sphere.position.clone(), grab, moved: false, pointerId: event.pointerId };
    this.view.controls.enabled = false;
    this.canvas.setPointerCapture(event.pointerId);
  }

  private onMove(event: PointerEvent): void {
    if (this.drag && event.pointerId !== this.drag.pointerId) {
      return;
    }
    const ray = this.view.rayAt(event.clientX, event.clientY);
    if (!this.drag) {
      this.canvas.classList.toggle("over", event.buttons === 0 && this.at(ray) !== null);
      return;
    }
    const mode = event.shiftKey ? "height" : event.altKey ? "surface" : this.events.mode();
    const target = this.target(ray, mode);
    if (target) {
      this.drag.moved = true;
      this.drag.sphere.position.copy(target);
      this.events.onDrag(this.drag.sphere.name, rounded(target));
      this.view.draw();
    }
  }

  private onUp(event: PointerEvent): void {
    if (event.pointerId === this.drag?.pointerId) {
      const { sphere, moved } = this.drag;
      this.drag = null;
      this.view.controls.enabled = true;
      this.canvas.releasePointerCapture(event.pointerId);
      if (moved) {
        this.events.onDrop(sphere.name, rounded(sphere.position));
      }
    }
  }

  /** Where the dragged sphere goes: on its level, up and down, or along the surfaces of the room. */
  private target(raycaster: Raycaster, mode: DragMode): Vector3 | null {
    const { sphere, start, grab } = this.drag!;
    const { ray } = raycaster;
    if (mode === "surface") {
      const hit = this.surface.hit(raycaster);
      return hit && hit.point.addScaledVector(hit.normal, RADIUS_M);
    }
    const isFlat = mode === "level" && Math.abs(ray.direction.y) > 0.15;
    const normal = isFlat ? UP : this.view.camera.getWorldDirection(new Vector3()).setY(0).normalize();
    const plane = new Plane().setFromNormalAndCoplanarPoint(normal, grab);
    const point = ray.intersectPlane(plane, new Vector3());
    if (!point || point.distanceTo(this.view.camera.position) > 30) {
      return null;
    }
    const moved = point.sub(grab).add(start);
    return mode === "height" ? sphere.position.clone().setY(moved.y) : moved.setY(start.y);
  }
}

function rounded({ x, y, z }: Vector3): Position {
  return [x, y, z].map((value) => Math.round(value * 1000) / 1000) as unknown as Position;
}
