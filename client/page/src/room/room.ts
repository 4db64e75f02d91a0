// The panel of the room in 3D: surface, probes, overlays and objects, and what clicks and buttons do there.

import { Matrix4, Vector3, type MeshBasicMaterial } from "three";
import type { Position } from "roomlight";
import { byId } from "../lib/dom";
import type { PlacedObjects } from "../objects";
import type { State } from "../state";
import { themeColour, onThemeChange } from "../lib/dom";
import { timed } from "../lib/parts";
import { markSeldomSeen, RoomCoverage } from "./coverage";
import { RoomObjects, type ObjectEvents } from "./objects";
import { RoomOverlays } from "./overlays";
import { RoomProbes, type DragMode } from "./probes";
import { RoomSurface, type SurfacePoint } from "./surface";
import { RoomView } from "./view";

const CLICK_PX = 5; // a shorter movement is a click

const SOFTWARE_TRIANGLES = 16_000; // without a graphics processor

export interface RoomEvents extends ObjectEvents {
  onDrag: (name: string, position: Position) => void;
  onDrop: (name: string, position: Position) => void;
  /** A click on a surface with a tool. */
  onPick: (tool: "object" | "probe", at: SurfacePoint) => void;
}

export class RoomPanel {
  readonly view: RoomView;
  readonly probes: RoomProbes;
  private readonly surface: RoomSurface;
  private readonly overlays: RoomOverlays;
  readonly objects: RoomObjects;
  private readonly coverage: RoomCoverage;
  private hasView = false; // whether the visitor has chosen it

  constructor(
    private readonly state: State,
    objects: PlacedObjects,
    private readonly events: RoomEvents,
  ) {
    const canvas = byId<HTMLCanvasElement>("room-canvas");
    this.view = new RoomView(canvas);
    state.meshTriangles.value = this.view.isSoftware ? SOFTWARE_TRIANGLES : state.meshTriangles.value;
    this.surface = new RoomSurface(this.view.scene);
    this.overlays = new RoomOverlays(this.view, state);
    this.objects = new RoomObjects(this.view, state, objects, events);
    this.coverage = new RoomCoverage(this.view.scene);
    this.probes = new RoomProbes(this.view, this.surface, state, canvas, {
      mode: () => checked("drag") as DragMode,
      ...events,
    });
    this.listen(canvas);
    this.watch(objects);
  }

  private watch(objects: PlacedObjects): void {
    const { state } = this;
    state.mesh.watch((glb) => void this.showMesh(glb).catch(this.events.report));
    const light = () => {
      this.probes.update();
      this.overlays.updateLights();
      this.objects.relight();
      this.showCoverage();
    };
    state.watchProbes(light);
    state.exposureEv.watch(() => {
      this.probes.update();
      this.objects.expose();
      this.showCoverage();
    });
    state.coverageTint.watch((on) => {
      this.probes.update();
      this.markMesh();
      this.showCoverage();
      byId<HTMLInputElement>("show-coverage").checked = on;
      byId("coverage-legend").hidden = !on;
    });
    onThemeChange(() => this.showCoverage());
    const camera = () => {
      this.overlays.updateCamera();
      this.coverage.walls(state.camera.value?.volume ?? null);
      this.showCoverage();
    };
    state.camera.watch(camera);
    state.shownEntry.watch(camera);
    objects.list.watch(() => this.objects.update());
    state.selected.watch(() => (this.hasView = false));
  }

  private async showMesh(glb: ArrayBuffer | null): Promise<void> {
    if (!(await this.surface.show(glb))) {
      return; // a newer mesh is shown
    }
    byId("room-waiting").hidden = this.surface.mesh !== null;
    if (this.surface.mesh) {
      this.coverage.paint(this.surface.mesh.material as MeshBasicMaterial);
      this.markMesh();
    }
    if (this.surface.mesh && !this.hasView) {
      this.overview(); // again with each larger mesh, until the visitor turns the view
    }
    this.view.drawSoon();
  }

  private showCoverage(): void {
    const { probe, coverageTint, exposureEv } = this.state;
    const sphere = probe && this.probes.spheres.get(probe.name);
    this.coverage.light(probe, sphere?.material.texture ?? null);
    this.coverage.show(coverageTint.value, themeColour("--accent"), 2 ** exposureEv.value);
    this.view.drawSoon();
  }

  /** Mark what few cameras have seen, for the tint; without the tint it costs nothing. */
  private markMesh(): void {
    const { mesh } = this.surface;
    if (mesh && this.state.coverageTint.value) {
      timed("coverage of the mesh", () => markSeldomSeen(mesh, this.state.camera.value));
    }
  }

  private overview(): void {
    const { samples } = this.surface;
    const points = samples.length > 0 ? samples : [new Vector3(-1, 0, -1), new Vector3(1, 2, 1)];
    const pose = this.state.camera.value?.camera_to_world;
    this.view.lookAt(points, pose ? new Vector3(pose[12], pose[13], pose[14]) : new Vector3(1, 1, 1));
  }

  private listen(canvas: HTMLCanvasElement): void {
    let down: { x: number; y: number } | null = null;
    canvas.addEventListener("pointerdown", (event) => {
      const onProbe = this.probes.at(this.view.rayAt(event.clientX, event.clientY)) !== null;
      down = event.button === 0 && !onProbe ? { x: event.clientX, y: event.clientY } : null;
    });
    canvas.addEventListener("pointerup", (event) => {
      const isClick = down && Math.hypot(event.clientX - down.x, event.clientY - down.y) < CLICK_PX;
      down = null;
      const hit = isClick && this.surface.hit(this.view.rayAt(event.clientX, event.clientY));
      if (hit) {
        this.events.onPick(checked("tool") as "object" | "probe", hit);
      }
    });
    this.view.controls.addEventListener("start", () => (this.hasView = true));
    canvas.addEventListener("keydown", () => (this.hasView = true));
    canvas.addEventListener("webglcontextrestored", () => this.objects.restore());
    byId("view-reset").addEventListener("click", () => {
      this.hasView = false;
      this.overview();
    });
    byId("view-camera").addEventListener("click", () => {
      this.hasView = true;
      const pose = this.state.camera.value?.camera_to_world;
      if (pose) {
        this.view.lookFrom(new Matrix4().fromArray([...pose]));
      }
    });
    byId("show-coverage").addEventListener("change", ({ target }) => {
      this.state.coverageTint.value = (target as HTMLInputElement).checked;
    });
    for (const name of ["path", "volume", "lights"] as const) {
      byId<HTMLInputElement>(`show-${name}`).addEventListener("change", ({ target }) => {
        this.overlays[name].visible = (target as HTMLInputElement).checked;
        this.view.draw();
      });
    }
  }
}

function checked(name: string): string {
  return document.querySelector<HTMLInputElement>(`input[name="${name}"]:checked`)!.value;
}
