// The virtual objects that the visitor has placed, and the composite that shows them in the camera's picture.

import { RoomLightError, type CompositeObject, type Position, type Session } from "roomlight";
import type { CameraState } from "./lib/answers";
import { latestOnly, Signal } from "./lib/signal";
import type { Picture, State } from "./state";

export type Shape = "sphere" | "cube" | "plane" | "chair" | "vase" | "file";
/** `own`: what the server gives the shape, or what the file says. */
export type Surface = "mirror" | "glossy" | "diffuse" | "own";
export type Quality = "preview" | "good" | "final";

/** An uploaded GLB file. */
export interface ObjectFile {
  /** Of the server. */
  readonly id: string;
  readonly name: string;
  readonly data: Blob;
}

export interface PlacedObject {
  readonly name: string;
  readonly shape: Shape;
  /** The shape `file`. */
  readonly file: ObjectFile | null;
  readonly material: Surface;
  readonly size_m: number;
  /** Where it was clicked: a pixel of the frame, or a point of the room. */
  readonly place: { readonly pixel: readonly [number, number] } | { readonly position: Position };
  /** Its pose once the server has placed it, column by column; it then stays there. */
  readonly pose: readonly number[] | null;
}

const PAUSE_MS = 400; // a session's frames wait while a composite is made
const MARGIN = 0.02; // of the picture's width and height
const MOST_UNDONE = 50;
const BAD_PLACES = new Set(["bad-place", "invalid"]);

export class PlacedObjects {
  readonly list = new Signal<readonly PlacedObject[]>([]);
  /** The picture with the objects; null without objects. */
  readonly composite = new Signal<Picture | null>(null);
  readonly busy = new Signal(false);
  /** The object that a click moves; null: a click places another one. */
  readonly selected = new Signal<string | null>(null);
  quality: Quality = "preview";
  private placed = 0;
  private cleared = 0;
  private past: (readonly PlacedObject[])[] = [];
  private undone: (readonly PlacedObject[])[] = [];

  constructor(
    private readonly state: State,
    private readonly session: () => Session | null,
    private readonly report: (error: unknown) => void,
  ) {}

  add(object: Omit<PlacedObject, "name" | "pose">): void {
    const name = `${object.shape}-${++this.placed}`;
    this.change([...this.list.value, { ...object, name, pose: null }]);
  }

  /** Place another object, or move the selected one. */
  put(object: Omit<PlacedObject, "name" | "pose">): void {
    const selected = this.selected.value;
    if (selected === null) {
      return this.add(object);
    }
    this.edit(selected, ({ pose: _, ...kept }) => ({ ...kept, place: object.place, pose: null }));
  }

  /** Turn an object about its own upright axis. */
  turn(name: string, degrees: number): void {
    this.edit(name, (object) => (object.pose ? { ...object, pose: turned(object.pose, degrees) } : object));
  }

  setMaterial(name: string, material: Surface): void {
    this.edit(name, (object) => ({ ...object, material }));
  }

  remove(name: string): void {
    this.change(this.list.value.filter((object) => object.name !== name));
  }

  get canUndo(): boolean {
    return this.past.length > 0;
  }

  get canRedo(): boolean {
    return this.undone.length > 0;
  }

  undo(): void {
    this.goTo(this.past, this.undone);
  }

  redo(): void {
    this.goTo(this.undone, this.past);
  }

  clear(): void {
    this.cleared++;
    [this.past, this.undone] = [[], []];
    this.show([]);
    this.showComposite(null);
  }

  private edit(name: string, change: (object: PlacedObject) => PlacedObject): void {
    this.change(this.list.value.map((object) => (object.name === name ? change(object) : object)));
  }

  private change(next: readonly PlacedObject[]): void {
    this.past = [...this.past.slice(-MOST_UNDONE), this.list.value];
    this.undone = [];
    this.show(next);
    this.update();
  }

  private goTo(from: (readonly PlacedObject[])[], to: (readonly PlacedObject[])[]): void {
    const next = from.pop();
    if (next) {
      to.push(this.list.value);
      this.show(next);
      this.update();
    }
  }

  private show(next: readonly PlacedObject[]): void {
    if (!next.some(({ name }) => name === this.selected.value)) {
      this.selected.value = null;
    }
    this.list.value = next;
  }

  /** Render the newest frame with the objects again. */
  readonly update = latestOnly(() => this.render(), PAUSE_MS);

  private async render(): Promise<void> {
    const session = this.session();
    const shown = this.list.value.filter((object) => isInView(object, this.state.camera.value));
    if (!session || shown.length === 0) {
      return this.showComposite(null);
    }
    this.busy.value = true;
    const { cleared } = this;
    try {
      const { data, frame, poses } = await session.composite({
        objects: shown.map(asRequest),
        quality: this.quality,
        format: "jpeg",
      });
      if (cleared !== this.cleared || this.list.value.length === 0) {
        return; // another session is shown, or the last object was removed
      }
      this.list.value = this.list.value.map((object) => ({ ...object, pose: object.pose ?? poses[object.name] ?? null }));
      this.showComposite({ blob: data, frame });
    } catch (error) {
      if (cleared === this.cleared) {
        this.refused(error);
      }
    } finally {
      this.busy.value = false;
    }
  }

  /** Take back an object that the server cannot place there. */
  private refused(error: unknown): void {
    if (error instanceof RoomLightError && error.kind === "composite-running") {
      return this.update(); // one that this page or another one asked for
    }
    const isPlace = error instanceof RoomLightError && BAD_PLACES.has(error.kind);
    if (isPlace) {
      const kept = this.list.value.filter(({ pose }) => pose !== null);
      if (kept.length < this.list.value.length) {
        const before = this.past.pop();
        this.show(before?.every(({ pose }) => pose !== null) ? before : kept); // a moved object goes back
        this.report(error);
        this.update();
      } else {
        this.showComposite(null); // placed objects that left the picture
      }
      return;
    }
    this.report(error);
  }

  private showComposite(picture: Picture | null): void {
    this.composite.value = picture;
  }
}

function asRequest({ name, shape, file, material, size_m, place, pose }: PlacedObject): CompositeObject {
  const where = pose ? { pose, anchor: "origin" as const } : place;
  const what = shape === "file" ? { object: file!.id } : { shape };
  return { name, ...what, size_m, ...(material === "own" ? {} : { material: { kind: material } }), ...where };
}

/** A pose after a turn about its second axis; poses are column by column. */
function turned(pose: readonly number[], degrees: number): readonly number[] {
  const [cos, sin] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
  const x = pose.slice(0, 4);
  const z = pose.slice(8, 12);
  return [
    ...x.map((value, row) => cos * value - sin * z[row]!),
    ...pose.slice(4, 8),
    ...x.map((value, row) => sin * value + cos * z[row]!),
    ...pose.slice(12),
  ];
}

/** Whether the middle of a placed object is in the picture; the server refuses objects that are not. */
function isInView({ pose }: PlacedObject, camera: CameraState | null): boolean {
  if (!pose || !camera?.camera_to_world || !camera.intrinsics) {
    return true;
  }
  const pixel = pixelOf([pose[12]!, pose[13]!, pose[14]!], camera);
  return pixel !== null && pixel.every((value) => value > MARGIN && value < 1 - MARGIN);
}

/** Where a point of the world is in the picture, as fractions of its width and height; null behind the camera. */
export function pixelOf(point: Position, camera: CameraState): readonly [number, number] | null {
  const pose = camera.camera_to_world!;
  const { fx, fy, cx, cy, width, height } = camera.intrinsics!;
  const offset = point.map((value, axis) => value - pose[12 + axis]!);
  const [x, y, z] = [0, 1, 2].map((column) => offset.reduce((sum, value, axis) => sum + value * pose[4 * column + axis]!, 0));
  return z! >= -0.05 ? null : [(cx - (fx * x!) / z!) / width, (cy + (fy * y!) / z!) / height];
}
