// The virtual objects in the 3D view, lit by the harmonics of the nearest probe.

import { Group, LightProbe, Matrix4, Vector3 } from "three";
import type { PlacedObject, PlacedObjects } from "../objects";
import type { State } from "../state";
import { MirrorMaterial } from "./mirror";
import { disposeOf, standIn } from "./shapes";
import type { RoomView } from "./view";

export class RoomObjects {
  private readonly shown = new Map<string, { group: Group; object: PlacedObject }>();
  private readonly mirror = new MirrorMaterial();
  private readonly light = new LightProbe();

  constructor(
    private readonly view: RoomView,
    private readonly state: State,
    private readonly objects: PlacedObjects,
  ) {
    view.scene.add(this.light);
  }

  update(): void {
    const placed = this.objects.list.value.filter(({ pose }) => pose !== null);
    const names = new Set(placed.map(({ name }) => name));
    for (const [name, { group }] of [...this.shown]) {
      if (!names.has(name)) {
        this.view.scene.remove(group);
        disposeOf(group, this.mirror);
        this.shown.delete(name);
      }
    }
    for (const object of placed) {
      let made = this.shown.get(object.name);
      if (!made) {
        made = { group: standIn(object, this.mirror), object };
        made.group.matrixAutoUpdate = false;
        this.shown.set(object.name, made);
        this.view.scene.add(made.group);
      }
      made.group.matrix.copy(new Matrix4().fromArray([...object.pose!]));
    }
    this.relight();
    this.view.drawSoon();
  }

  /** Light the stand-ins as the probe next to the first object sees the room. */
  relight(): void {
    const first = this.shown.values().next().value?.group;
    if (!first) {
      return;
    }
    const here = new Vector3().setFromMatrixPosition(first.matrix);
    const distance = (position: readonly number[]) => here.distanceTo(new Vector3(...position));
    const [nearest] = [...this.state.probes.values()].sort((a, b) => distance(a.position) - distance(b.position));
    const gain = 2 ** this.state.exposureEv.value;
    if (nearest) {
      this.mirror.show(nearest);
      this.mirror.set("gain", gain);
      if (nearest.harmonics) {
        this.light.sh.fromArray([...nearest.harmonics]);
        this.light.intensity = gain;
      }
    }
  }
}
