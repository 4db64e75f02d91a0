// The placed objects and the title that the server keeps with a session, the same for everyone who looks at it.

import { RoomLightError, type CompositeObject } from "roomlight";
import type { Api } from "./lib/api";
import { latestOnly } from "./lib/signal";
import { asRequest, type PlacedObject, type PlacedObjects, type Shape, type Surface } from "./objects";
import type { State } from "./state";

const SURFACES: readonly string[] = ["mirror", "glossy", "diffuse"];

/** Sends what the visitor places, and shows what others place. Of two changes of one object the last stays. */
export class SharedScene {
  /** The scene on the server; null until it is read. */
  private known: { readonly title: string; readonly objects: readonly PlacedObject[]; readonly etag: string } | null = null;
  private joined: string | null = null;

  constructor(
    private readonly api: Api,
    private readonly state: State,
    private readonly objects: PlacedObjects,
    private readonly report: (error: unknown) => void,
  ) {
    objects.list.watch(() => this.keep());
    state.camera.watch(() => this.read());
    state.connection.watch(({ text }) => {
      if (text === "Live") {
        this.keep(); // what was placed while the server was away
        if (objects.list.value.some(({ pose }) => pose === null)) {
          objects.update();
        }
      }
    });
  }

  /** Another session is shown. */
  join(id: string | null): void {
    [this.joined, this.known] = [id, null];
    this.read();
  }

  async rename(id: string, title: string): Promise<void> {
    const { objects, etag } = await this.api.scene(id);
    try {
      await this.api.keepScene(id, { title, objects }, etag);
    } catch (error) {
      return isChanged(error) ? this.rename(id, title) : Promise.reject(error);
    }
    this.read();
  }

  /** Read what others have placed; called with each frame and each look at the list of sessions. */
  readonly read = latestOnly(async () => {
    const [id, before] = [this.joined, this.known];
    try {
      const scene = id === null ? null : await this.api.scene(id);
      if (scene === null || id !== this.joined || before !== this.known || scene.etag === before?.etag) {
        return;
      }
      const [own, objects] = [this.objects.list.value, scene.objects.map(placedOf)];
      this.known = { title: scene.title, objects, etag: scene.etag };
      if (before === null && own.length > 0 && objects.length === 0) {
        this.keep(); // placed before the first answer
      } else if (textOf(objects) !== textOf(own)) {
        this.objects.adopt(before?.objects ?? own, objects);
      }
    } catch {
      // the stream reports a session that has ended, and the banner a server that is gone
    }
  });

  private readonly keep = latestOnly(async () => {
    const [id, before] = [this.joined, this.known];
    if (id === null || before === null) {
      return;
    }
    const known = new Map(before.objects.map((object) => [object.name, object]));
    // an object whose place the server has not found yet is kept as it was
    const objects = this.objects.list.value.flatMap((object) => (object.pose ? object : (known.get(object.name) ?? [])));
    if (textOf(objects) === textOf(before.objects)) {
      return;
    }
    try {
      const etag = await this.api.keepScene(id, { title: before.title, objects: objects.map(asRequest) }, before.etag);
      if (before === this.known) {
        this.known = { ...before, objects, etag };
      }
    } catch (error) {
      if (isChanged(error)) {
        this.read(); // what the visitor changed is then kept with what others have
      } else if (!this.state.ended.value) {
        this.report(error);
      }
    }
  });
}

function isChanged(error: unknown): boolean {
  return error instanceof RoomLightError && error.kind === "scene-changed";
}

function textOf(list: readonly PlacedObject[]): string {
  return JSON.stringify(list.map(asRequest));
}

/** An object of the server's scene as the page shows it; what the page has no field for stays in `kept`. */
function placedOf(item: CompositeObject): PlacedObject {
  const { name, shape, object, material, size_m, pose, position, ...rest } = item;
  const isPlain = material != null && SURFACES.includes(material.kind) && material.base_colour == null && material.roughness == null;
  const { up, yaw_degrees, anchor, ...other } = rest;
  const kept = {
    ...other,
    ...(up === "z" ? { up } : {}),
    ...(pose == null ? { yaw_degrees, anchor } : {}),
    ...(material != null && !isPlain ? { material } : {}),
  };
  return {
    name: name ?? "object",
    shape: object != null ? "file" : (shape as Shape),
    file: object != null ? { id: object, name: `${name ?? "object"}.glb`, data: null, box: null } : null,
    material: isPlain ? (material.kind as Surface) : "own",
    size_m: size_m ?? null,
    place: { position: (position ?? [0, 0, 0]) as CompositeObject["position"] & [number, number, number] },
    pose: pose ?? null,
    kept: Object.fromEntries(Object.entries(kept).filter(([, value]) => value !== null)),
  };
}
