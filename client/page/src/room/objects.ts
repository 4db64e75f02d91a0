// The virtual objects in the 3D view, each lit by the server's panorama at its place.

import { findFormFor, parseHdr, type Light, type Position } from "roomlight";
import { environmentTexture } from "roomlight/three";
import { MeshStandardMaterial, type Group, type WebGLRenderTarget } from "three";
import { timed } from "../lib/parts";
import { latestOnly } from "../lib/signal";
import type { PlacedObject, PlacedObjects } from "../objects";
import type { State } from "../state";
import { MirrorMaterial } from "./mirror";
import { disposeOf, materialsOf, shapeOf } from "./shapes";
import type { RoomView } from "./view";

const PAUSE_MS = 1000; // between two requests for the light of all objects

interface Shown {
  readonly group: Group;
  object: PlacedObject;
  environment: WebGLRenderTarget | null;
  /** What identifies the light that it shows. */
  etag: string;
}

export interface ObjectEvents {
  /** The light at points of the room; null while there is no session. */
  lightAt: (positions: readonly Position[]) => Promise<readonly Light[] | null>;
  report: (error: unknown) => void;
}

/** Whether two objects differ in their poses alone. */
function isAlike(one: PlacedObject, other: PlacedObject): boolean {
  const isSameFile = one.file?.id === other.file?.id && !one.file?.data === !other.file?.data;
  return isSameFile && one.shape === other.shape && one.material === other.material && one.size_m === other.size_m;
}

export class RoomObjects {
  private readonly shown = new Map<string, Shown>();
  private readonly refresh = latestOnly(() => this.build());
  private readonly readLight = latestOnly(() => this.light(), PAUSE_MS);

  constructor(
    private readonly view: RoomView,
    private readonly state: State,
    private readonly objects: PlacedObjects,
    private readonly events: ObjectEvents,
  ) {}

  /** Names of the objects that show the light at their place. */
  get lit(): string[] {
    return [...this.shown].filter(([, { etag }]) => etag !== "").map(([name]) => name);
  }

  /** Show the placed objects. */
  update(): void {
    this.refresh();
  }

  /** The room's light has changed. */
  relight(): void {
    if (this.shown.size > 0) {
      this.readLight();
    }
  }

  /** The graphics context was lost, and with it what `apply` has made. */
  restore(): void {
    this.shown.forEach((one) => (one.etag = ""));
    this.relight();
  }

  /** Apply the exposure. */
  expose(): void {
    const gain = 2 ** this.state.exposureEv.value;
    for (const { group } of this.shown.values()) {
      for (const material of materialsOf(group)) {
        if (material instanceof MirrorMaterial) {
          material.set("gain", gain);
        } else if (material instanceof MeshStandardMaterial) {
          material.envMapIntensity = gain;
        }
      }
    }
    this.view.drawSoon();
  }

  private async build(): Promise<void> {
    const placed = this.objects.list.value.filter(({ pose }) => pose !== null);
    const names = new Set(placed.map(({ name }) => name));
    for (const [name, one] of [...this.shown]) {
      if (!names.has(name)) {
        this.view.scene.remove(one.group);
        disposeOf(one.group);
        one.environment?.dispose();
        this.shown.delete(name);
      }
    }
    for (const object of placed) {
      const before = this.shown.get(object.name);
      if (before && isAlike(before.object, object)) {
        if (before.object !== object) {
          before.object = object;
          before.etag = "";
          before.group.matrix.fromArray([...object.pose!]);
        }
        continue;
      }
      if (before) {
        this.view.scene.remove(before.group);
        disposeOf(before.group);
        before.environment?.dispose();
      }
      try {
        const group = await shapeOf(object, this.events.report);
        group.matrixAutoUpdate = false;
        group.matrix.fromArray([...object.pose!]);
        this.shown.set(object.name, { group, object, environment: null, etag: "" });
        this.view.scene.add(group);
      } catch (error) {
        this.events.report(error);
      }
    }
    this.view.drawSoon();
    this.relight();
  }

  private async light(): Promise<void> {
    const all = [...this.shown.values()];
    const positions = all.map(({ object: { pose } }) => [pose![12]!, pose![13]!, pose![14]!] as const);
    try {
      const lights = (positions.length > 0 && (await this.events.lightAt(positions))) || [];
      lights.forEach((light, at) => this.apply(all[at]!, light));
    } catch (error) {
      this.events.report(error);
    }
    this.expose();
  }

  private apply(one: Shown, light: Light): void {
    const form = findFormFor("lighting", light, "hdr");
    const seen = findFormFor("reflection", light, "hdr");
    if (!form?.data || !seen?.data || light.etag === one.etag || this.shown.get(one.object.name) !== one) {
      return;
    }
    one.etag = light.etag;
    const { data } = seen;
    timed("light of an object", () => {
      const materials = [...materialsOf(one.group)];
      if (materials.some((material) => material instanceof MeshStandardMaterial)) {
        const panorama = environmentTexture(form);
        one.environment?.dispose();
        one.environment = this.view.environmentOf(panorama);
        panorama.dispose();
      }
      for (const material of materials) {
        if (material instanceof MirrorMaterial) {
          material.show({ panorama: parseHdr(data), seen: null });
        } else if (material instanceof MeshStandardMaterial) {
          material.envMap = one.environment?.texture ?? null;
          material.needsUpdate = true;
        }
      }
    });
  }
}
