// The virtual objects that the visitor has placed, and the composite that shows them in the camera's picture.

import { RoomLightError, type CameraView, type CompositeObject, type ObjectInfo, type Position, type Session } from "roomlight";
import { latestOnly, Signal } from "./lib/signal";
import type { Picture, State } from "./state";

export type Shape = "sphere" | "cube" | "plane" | "chair" | "vase" | "teapot" | "file";
/** `own`: what the server gives the shape, or what the file says. */
export type Surface = "mirror" | "glossy" | "diffuse" | "own";
export type Quality = "preview" | "good" | "final";

/** An uploaded GLB file. */
export interface ObjectFile {
  /** Of the server. */
  readonly id: string;
  readonly name: string;
  /** Null if another page has uploaded it: the 3D view then leaves it out. */
  readonly data: Blob | null;
  /** Its box in its own metres; null if another page has uploaded it. */
  readonly box: Pick<ObjectInfo, "lower_m" | "size_m"> | null;
}

export interface PlacedObject {
  readonly name: string;
  readonly shape: Shape;
  /** The shape `file`. */
  readonly file: ObjectFile | null;
  readonly material: Surface;
  /** Null: a file's own metres. */
  readonly size_m: number | null;
  /** Where it was clicked: a pixel of the frame, or a point of the room. */
  readonly place: { readonly pixel: readonly [number, number] } | { readonly position: Position };
  /** Its pose once the server has placed it, column by column; it then stays there. */
  readonly pose: readonly number[] | null;
  /** What another program stated and the page does not show, such as colours. */
  readonly kept?: Partial<CompositeObject>;
}

/** Size and material that a shape has where nothing else is stated; the size is the server's. */
export const USUAL: Readonly<Record<Exclude<Shape, "file">, { readonly size_cm: number; readonly material: Surface }>> = {
  sphere: { size_cm: 20, material: "mirror" },
  cube: { size_cm: 20, material: "diffuse" },
  plane: { size_cm: 50, material: "mirror" },
  chair: { size_cm: 85, material: "own" },
  vase: { size_cm: 30, material: "own" },
  teapot: { size_cm: 30, material: "own" },
};
const PAUSE_MS = 400; // a session's frames wait while a composite is made
const MOST_UNDONE = 50;
const BAD_PLACES = new Set(["bad-place", "invalid"]);

export class PlacedObjects {
  readonly list = new Signal<readonly PlacedObject[]>([]);
  /** The picture with the objects; null without objects. */
  readonly composite = new Signal<Picture | null>(null);
  /** Share of each object that nothing real hides, in the composite that is shown. */
  readonly visible = new Signal<{ readonly [name: string]: number }>({});
  readonly busy = new Signal(false);
  /** The object that a click moves; null: a click places another one. */
  readonly selected = new Signal<string | null>(null);
  quality: Quality = "preview";
  private cleared = 0;
  /** Files that the server no longer has, nor this page. */
  private readonly lost = new Set<string | undefined>();
  /** Where others have placed objects that have no pose so far. */
  private readonly given = new WeakSet<PlacedObject["place"]>();
  private past: (readonly PlacedObject[])[] = [];
  private undone: (readonly PlacedObject[])[] = [];

  constructor(
    private readonly state: State,
    private readonly session: () => Session | null,
    private readonly upload: (file: Blob) => Promise<unknown>,
    private readonly report: (error: unknown) => void,
  ) {}

  add(object: Omit<PlacedObject, "name" | "pose">): void {
    const kind = object.file ? plainName(object.file.name) : object.shape;
    this.lost.delete(object.file?.id);
    this.change([...this.list.value, { ...object, name: freeName(kind, this.list.value), pose: null }]);
  }

  /** Show what others have made of `base`; what the visitor has changed since stays, and can be undone. */
  adopt(base: readonly PlacedObject[], theirs: readonly PlacedObject[]): void {
    const files = new Map(this.list.value.map(({ file }) => [file?.id, file]));
    const names = new Map<string, string>();
    theirs.forEach(({ place, pose }) => pose ?? this.given.add(place));
    const next = merged(
      base,
      this.list.value,
      theirs.map((object) => ({ ...object, file: files.get(object.file?.id) ?? object.file })),
      names,
    );
    const renamed = (list: readonly PlacedObject[]) => list.map((object) => ({ ...object, name: names.get(object.name) ?? object.name }));
    const own = renamed(this.list.value);
    const rebased = (list: readonly PlacedObject[]) => merged(own, renamed(list), next);
    [this.past, this.undone] = [this.past.map(rebased), this.undone.map(rebased)];
    this.selected.value = names.get(this.selected.value ?? "") ?? this.selected.value;
    this.show(next);
    this.update();
  }

  /** Place another object, or move the selected one. */
  put(object: Omit<PlacedObject, "name" | "pose">): void {
    const selected = this.selected.value;
    if (selected === null) {
      return this.add(object);
    }
    this.move(selected, object.place);
  }

  /** Move an object to another place; it keeps its turn. */
  move(name: string, place: PlacedObject["place"]): void {
    this.edit(name, (object) => {
      const yaw_degrees = object.pose ? (Math.atan2(object.pose[8]!, object.pose[10]!) * 180) / Math.PI : 0;
      return { ...object, place, pose: null, kept: { ...object.kept, yaw_degrees } };
    });
  }

  /** Turn an object about its own upright axis. */
  turn(name: string, degrees: number): void {
    this.edit(name, (object) => (object.pose ? { ...object, pose: turned(object.pose, degrees) } : object));
  }

  /** Scale an object; a shape keeps its foot where it stands, a file its origin. */
  resize(name: string, size_m: number): void {
    this.edit(name, (object) => {
      const { pose, size_m: before } = object;
      const lift = before === null ? 0 : boxOf(object.shape)[1] * (before - size_m) * Number(object.shape !== "file");
      return { ...object, size_m, pose: pose?.map((value, at) => (at >= 12 && at < 15 ? value + lift * pose[at - 8]! : value)) ?? null };
    });
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

  /** Whether an object cannot be shown: its file is neither on the server nor in this page. */
  isLost({ file }: PlacedObject): boolean {
    return this.lost.has(file?.id);
  }

  /** Whether an object stays where it is though the picture does not show it: the server, or others, have placed it. */
  private isSettled({ pose, place }: PlacedObject): boolean {
    return pose !== null || this.given.has(place);
  }

  /** Render the newest frame with the objects again. */
  readonly update = latestOnly(() => this.render(), PAUSE_MS);

  /** `outside`: objects that the server has found outside the picture. */
  private async render(outside: readonly PlacedObject[] = []): Promise<void> {
    const session = this.session();
    const { camera } = this.state;
    const shown = this.list.value.filter((object) => !outside.includes(object) && !this.isLost(object) && isInView(object, camera.value));
    if (!session || shown.length === 0) {
      return this.showComposite(null);
    }
    this.busy.value = true;
    const { cleared } = this;
    try {
      const { data, frame, poses, visible } = await session.composite({
        objects: shown.map(asRequest),
        quality: this.quality,
        format: "jpeg",
      });
      if (cleared !== this.cleared || this.list.value.length === 0) {
        return; // another session is shown, or the last object was removed
      }
      // What was moved meanwhile waits for the next composite; the others stay the same objects and keep their light.
      this.list.value = this.list.value.map((object) =>
        shown.includes(object) && object.pose === null ? { ...object, pose: poses[object.name] ?? null } : object,
      );
      this.visible.value = visible;
      this.showComposite({ blob: data, frame });
    } catch (error) {
      const { rule } = error instanceof RoomLightError ? error : { rule: "" };
      const gone = shown.find((object) => this.isSettled(object) && rule.startsWith(`${object.name}: lies `));
      if (cleared === this.cleared) {
        await (gone ? this.render([...outside, gone]) : this.refused(error));
      }
    } finally {
      this.busy.value = false;
    }
  }

  /** Take back an object that the server cannot place there; send a file again that it has no more. */
  private async refused(error: unknown): Promise<void> {
    if (error instanceof RoomLightError && error.kind === "object-not-found") {
      return this.restoreFile(error);
    }
    if (error instanceof RoomLightError && error.kind === "composite-running") {
      return this.update(); // those of two other pages
    }
    const isPlace = error instanceof RoomLightError && BAD_PLACES.has(error.kind);
    if (isPlace) {
      const kept = this.list.value.filter((object) => this.isSettled(object));
      if (kept.length < this.list.value.length) {
        const before = this.past.pop();
        this.show(before?.every((object) => this.isSettled(object)) ? before : kept); // a moved object goes back
        this.report(error);
        this.update();
      } else {
        this.showComposite(null); // placed objects that left the picture
      }
      return;
    }
    this.report(error);
  }

  private async restoreFile({ value }: RoomLightError): Promise<void> {
    const { name, file } = this.list.value.find(({ file }) => file?.id === value) ?? {};
    try {
      if (!file?.data) {
        throw new Error(`The server no longer has the file of ${name}, which is not shown: choose the file again and place it.`);
      }
      await this.upload(file.data);
    } catch (error) {
      this.lost.add(String(value));
      this.report(error);
    }
    this.update();
  }

  private showComposite(picture: Picture | null): void {
    this.composite.value = picture;
  }
}

/** The first name `kind-1`, `kind-2`, .. that no object has. */
function freeName(kind: string, objects: readonly PlacedObject[]): string {
  let number = 1;
  while (objects.some(({ name }) => name === `${kind}-${number}`)) {
    number++;
  }
  return `${kind}-${number}`;
}

/** Their objects with the changes that have led from `base` to `own`; `names` gets those of new objects that are taken. */
function merged(
  base: readonly PlacedObject[],
  own: readonly PlacedObject[],
  theirs: readonly PlacedObject[],
  names = new Map<string, string>(),
): readonly PlacedObject[] {
  const [before, now] = [base, own].map((list) => new Map(list.map((object) => [object.name, object])));
  const next = theirs.flatMap((object) => {
    const [was, is] = [before!.get(object.name), now!.get(object.name)];
    return was === undefined ? [object] : is === undefined ? [] : [isSame(was, is) ? object : is];
  });
  for (const object of own.filter(({ name }) => !before!.has(name))) {
    const taken = next.find(({ name }) => name === object.name);
    if (taken === undefined) {
      next.push(object);
    } else if (!isSame(taken, object)) {
      names.set(object.name, freeName(object.name.replace(/-\d+$/, ""), [...next, ...own]));
      next.push({ ...object, name: names.get(object.name)! });
    }
  }
  return next;
}

function isSame(one: PlacedObject, other: PlacedObject): boolean {
  return JSON.stringify(asRequest(one)) === JSON.stringify(asRequest(other));
}

/** The name of a file without its ending, in letters that an object's name may have. */
function plainName(file: string): string {
  const plain = file.replace(/\.\w+$/, "").replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "");
  return plain.slice(0, 40) || "file";
}

/** Half the width, bottom and top of a shape about its origin, relative to its size. */
export function boxOf(shape: Shape): readonly [number, number, number] {
  const boxes: Partial<Record<Shape, readonly [number, number, number]>> = {
    plane: [0.5, 0, 0],
    chair: [0.25, 0, 1],
    vase: [0.29, 0, 1],
    teapot: [0.53, 0, 0.49],
  };
  return boxes[shape] ?? [0.5, -0.5, 0.5];
}

/** The size of an object whose file is not known here, metres. */
export function sizeOf({ shape, size_m }: PlacedObject): number {
  return size_m ?? (shape === "file" ? 1 : USUAL[shape].size_cm / 100);
}

/** Lower and upper corner of the box around an object about its origin, metres. */
function cornersAbout(object: PlacedObject): readonly [Position, Position] {
  const { shape, file, size_m } = object;
  if (file?.box) {
    const { lower_m: [x, y, z], size_m: [width, height, depth] } = file.box;
    const scale = size_m === null ? 1 : size_m / (Math.max(width, height, depth) || 1);
    return [[scale * x, scale * y, scale * z], [scale * (x + width), scale * (y + height), scale * (z + depth)]];
  }
  const [half, bottom, top] = boxOf(shape).map((value) => value * sizeOf(object)) as [number, number, number];
  return [[-half, bottom, -half], [half, top, half]];
}

/** The object as a composite and a scene have it. */
export function asRequest({ name, shape, file, material, size_m, place, pose, kept }: PlacedObject): CompositeObject {
  const { yaw_degrees = 0, anchor = "base", ...rest } = kept ?? {};
  const where = pose ? { pose, anchor: "origin" as const } : { ...place, yaw_degrees, ...("position" in place ? { anchor } : {}) };
  const what = shape === "file" ? { object: file!.id } : { shape };
  const size = size_m === null ? {} : { size_m };
  return { ...rest, name, ...what, ...size, ...(material === "own" ? {} : { material: { kind: material } }), ...where };
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

/** Whether the box around a placed object touches the picture; the server refuses objects that are outside. */
function isInView(object: PlacedObject, camera: CameraView | null): boolean {
  const corners = cornersOf(object, camera);
  const ahead = corners.filter((corner) => corner !== null);
  const isAcross = (axis: 0 | 1) => ahead.some((corner) => corner[axis] < 1) && ahead.some((corner) => corner[axis] > 0);
  return corners.length === 0 || (ahead.length > 0 && (ahead.length < corners.length || (isAcross(0) && isAcross(1))));
}

/** Corners of the box around an object, as `pixelOf` has them, the four of its base first; none before it is placed. */
export function cornersOf(object: PlacedObject, camera: CameraView | null): ReturnType<typeof pixelOf>[] {
  const { pose } = object;
  if (!pose || !camera?.camera_to_world || !camera.intrinsics) {
    return [];
  }
  const [lower, upper] = cornersAbout(object);
  return [lower[1], upper[1]].flatMap((y) =>
    [lower[2], upper[2]].flatMap((z) =>
      [lower[0], upper[0]].map((x) => {
        const world = [0, 1, 2].map((axis) => pose[axis]! * x + pose[4 + axis]! * y + pose[8 + axis]! * z + pose[12 + axis]!);
        return pixelOf(world as unknown as Position, camera);
      }),
    ),
  );
}

/** Where a point of the world is in the picture, as fractions of its width and height; null behind the camera. */
export function pixelOf(point: Position, camera: CameraView): readonly [number, number] | null {
  const pose = camera.camera_to_world!;
  const { fx, fy, cx, cy, width, height } = camera.intrinsics!;
  const offset = point.map((value, axis) => value - pose[12 + axis]!);
  const [x, y, z] = [0, 1, 2].map((column) => offset.reduce((sum, value, axis) => sum + value * pose[4 * column + axis]!, 0));
  return z! >= -0.05 ? null : [(cx - (fx * x!) / z!) / width, (cy + (fy * y!) / z!) / height];
}
