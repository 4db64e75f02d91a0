// Stand-ins for the virtual objects in the 3D view; the camera's picture shows them as the server renders them.

import { BoxGeometry, Group, LatheGeometry, Mesh, MeshStandardMaterial, SphereGeometry, Vector2, type Material } from "three";
import type { PlacedObject } from "../objects";
import type { MirrorMaterial } from "./mirror";

type Box = readonly [x: number, y: number, z: number, width: number, height: number, depth: number];

/** The chair of the server, relative to its height. */
const CHAIR: readonly Box[] = [
  ...([-0.22, 0.22] as const).flatMap((x): Box[] => [
    [x, 0.5, -0.22, 0.04, 1, 0.04],
    [x, 0.24, 0.22, 0.04, 0.48, 0.04],
    [x, 0.25, 0, 0.025, 0.025, 0.4],
  ]),
  [0, 0.5, 0.02, 0.5, 0.04, 0.5],
  ...([0.68, 0.81, 0.94] as const).map((y): Box => [0, y, -0.22, 0.4, 0.09, 0.025]),
];

/** The outline of the server's vase: radius and height, relative to the height. */
const VASE: readonly (readonly [number, number])[] = [
  [0, 0], [0.17, 0], [0.19, 0.02], [0.24, 0.15], [0.29, 0.32], [0.27, 0.5], [0.18, 0.68], [0.115, 0.8], [0.11, 0.88],
  [0.135, 0.95], [0.165, 1],
];

/** An object about its origin, as the server places it. */
export function standIn({ shape, material, size_m }: PlacedObject, mirror: MirrorMaterial): Group {
  const paint: Material = material === "mirror" ? mirror : matte(material === "glossy" ? 0.25 : 1, shape);
  const group = new Group();
  if (shape === "sphere") {
    group.add(new Mesh(new SphereGeometry(size_m / 2, 48, 32), paint));
  } else if (shape === "cube") {
    group.add(new Mesh(new BoxGeometry(size_m, size_m, size_m), paint));
  } else if (shape === "vase") {
    const outline = VASE.map(([radius, height]) => new Vector2(radius * size_m, height * size_m));
    group.add(new Mesh(new LatheGeometry(outline, 48), paint));
  } else {
    for (const [x, y, z, width, height, depth] of CHAIR) {
      const piece = new Mesh(new BoxGeometry(width * size_m, height * size_m, depth * size_m), paint);
      piece.position.set(x, y, z).multiplyScalar(size_m);
      group.add(piece);
    }
  }
  return group;
}

/** Free a stand-in's memory, except for the shared mirror. */
export function disposeOf(group: Group, mirror: MirrorMaterial): void {
  group.traverse((node) => {
    if (node instanceof Mesh) {
      node.geometry.dispose();
      if (node.material !== mirror) {
        (node.material as Material).dispose();
      }
    }
  });
}

function matte(roughness: number, shape: string): MeshStandardMaterial {
  return new MeshStandardMaterial({ color: shape === "chair" ? 0xb18f6b : 0xe7e7e7, roughness });
}
