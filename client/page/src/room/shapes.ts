// The virtual objects as the server renders them: its shapes, or the uploaded file, with their material.

import {
  Box3,
  BoxGeometry,
  BufferGeometry,
  DoubleSide,
  Group,
  LatheGeometry,
  Mesh,
  MeshPhysicalMaterial,
  PlaneGeometry,
  SphereGeometry,
  Texture,
  Vector2,
  Vector3,
  type Material,
} from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";
import { sizeOf, type PlacedObject, type Shape } from "../objects";
import { MirrorMaterial } from "./mirror";

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

/** The outline of the server's vase, outside and inside: radius and height, relative to the height. */
const VASE: readonly (readonly [number, number])[] = [
  [0, 0], [0.17, 0], [0.19, 0.02], [0.24, 0.15], [0.29, 0.32], [0.27, 0.5], [0.18, 0.68], [0.115, 0.8], [0.11, 0.88],
  [0.135, 0.95], [0.165, 1], [0.145, 0.99], [0.11, 0.93], [0.09, 0.86], [0.1, 0.78], [0.16, 0.66], [0.25, 0.5],
  [0.26, 0.32], [0.21, 0.15], [0.15, 0.04], [0, 0.03],
];

const GREY = [0.8, 0.8, 0.8] as const; // linear RGB
const WOOD = [0.45, 0.28, 0.15] as const;
const GLOSSY_IOR = 1.576; // reflects 5 % at normal incidence

/** An object about its origin, as the server places it. Rejects if its file cannot be read; `report` says what is not shown. */
export async function shapeOf(object: PlacedObject, report: (error: unknown) => void): Promise<Group> {
  const { shape, material, size_m, file } = object;
  const group = new Group();
  if (!file?.data) {
    if (file) {
      return group; // uploaded by another page
    }
    group.add(new Mesh(geometryOf(shape, sizeOf(object)), materialOf(material === "own" ? "diffuse" : material, shape, material === "own")));
    return group;
  }
  const scene = await sceneOf(file.data);
  if (scene === null) {
    report(new Error(`A box stands for ${file.name} here: only the server unpacks Draco meshes and KTX2 textures; the picture shows it.`));
    group.add(new Mesh(geometryOf("cube", size_m ?? 0.3), materialOf("diffuse", "cube", false)));
    return group;
  }
  const size = new Box3().setFromObject(scene).getSize(new Vector3());
  const longest = Math.max(size.x, size.y, size.z) || 1;
  scene.scale.multiplyScalar((size_m ?? longest) / longest);
  if (material !== "own") {
    const paint = materialOf(material, shape, false);
    scene.traverse((node) => node instanceof Mesh && (node.material = paint));
  }
  group.add(scene);
  return group;
}

/** Read a GLB without its lamps; null if it is packed in a way that only the server unpacks. */
async function sceneOf(file: Blob): Promise<Group | null> {
  const { MeshoptDecoder } = await import("three/addons/libs/meshopt_decoder.module.js");
  try {
    const { scene } = await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).parseAsync(await file.arrayBuffer(), "");
    scene.getObjectsByProperty("isLight", true).forEach((lamp) => lamp.removeFromParent()); // they would light the room's view
    return scene;
  } catch (error) {
    if (/DRACOLoader|KTX2Loader/.test(String(error))) {
      return null;
    }
    throw error;
  }
}

/** The materials of an object, each once. */
export function materialsOf(group: Group): Set<Material> {
  const found = new Set<Material>();
  group.traverse((node) => node instanceof Mesh && [node.material].flat().forEach((one: Material) => found.add(one)));
  return found;
}

/** Free an object's memory. */
export function disposeOf(group: Group): void {
  for (const material of materialsOf(group)) {
    Object.values(material).forEach((value) => value instanceof Texture && value.dispose());
    material.dispose();
  }
  group.traverse((node) => node instanceof Mesh && node.geometry.dispose());
}

function geometryOf(shape: Shape, size_m: number): BufferGeometry {
  switch (shape) {
    case "sphere":
      return new SphereGeometry(size_m / 2, 48, 32);
    case "plane":
      return new PlaneGeometry(size_m, size_m).rotateX(-Math.PI / 2);
    case "vase":
      return new LatheGeometry(
        VASE.map(([radius, height]) => new Vector2(radius * size_m, height * size_m)),
        48,
      );
    case "chair":
      return mergeGeometries(
        CHAIR.map(([x, y, z, width, height, depth]) =>
          new BoxGeometry(width, height, depth).translate(x, y, z).scale(size_m, size_m, size_m),
        ),
      );
    default:
      return new BoxGeometry(size_m, size_m, size_m);
  }
}

/** The server's materials: a white mirror, a glossy or a diffuse grey. */
function materialOf(kind: "mirror" | "glossy" | "diffuse", shape: Shape, isOwn: boolean): Material {
  if (kind === "mirror") {
    return Object.assign(new MirrorMaterial(), { side: DoubleSide });
  }
  const made = new MeshPhysicalMaterial({ roughness: kind === "glossy" ? 0.2 : 1, side: DoubleSide });
  const [red, green, blue] = shape === "chair" && isOwn ? WOOD : GREY;
  made.color.setRGB(red, green, blue);
  if (kind === "glossy") {
    made.ior = GLOSSY_IOR;
  } else {
    made.specularIntensity = 0;
  }
  return made;
}
