// The room's fused mesh: unlit, with the colours of the frames, and the surface that clicks and drags meet.

import { Box3, FrontSide, Mesh, MeshBasicMaterial, Vector3, type Raycaster, type Scene } from "three";
import { timed } from "../lib/parts";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const SAMPLES = 1000;
const OUTER = 0.01; // share of the vertices on each side

export interface SurfacePoint {
  readonly point: Vector3;
  readonly normal: Vector3;
}

export class RoomSurface {
  mesh: Mesh | null = null;
  /** Some points of the mesh. */
  samples: readonly Vector3[] = [];
  private asked = 0;
  private shown = 0;
  private readonly loader = new GLTFLoader();

  constructor(private readonly scene: Scene) {}

  /** Show the mesh of a GLB file; null shows nothing. Resolves to false if a newer call came first. */
  async show(glb: ArrayBuffer | null): Promise<boolean> {
    const order = ++this.asked;
    if (glb) {
      await idle();
    }
    const loaded = glb && order === this.asked ? await this.loader.parseAsync(glb, "") : null;
    if (glb && !loaded) {
      return false;
    }
    let next: Mesh | null = null;
    loaded?.scene.traverse((node) => {
      if (node instanceof Mesh && !next) {
        next = node;
      }
    });
    if (order < this.shown) {
      return false;
    }
    this.shown = order;
    timed("mesh", () => this.replace(next));
    return true;
  }

  /** The first point of the surface along a ray, with the normal toward the ray's origin. */
  hit(ray: Raycaster): SurfacePoint | null {
    const hit = this.mesh ? ray.intersectObject(this.mesh, false)[0] : undefined;
    if (!hit?.face) {
      return null;
    }
    const normal = hit.face.normal.clone();
    return { point: hit.point, normal: normal.dot(ray.ray.direction) > 0 ? normal.negate() : normal };
  }

  private replace(next: Mesh | null): void {
    if (this.mesh) {
      this.scene.remove(this.mesh);
      this.mesh.geometry.dispose();
      (this.mesh.material as MeshBasicMaterial).dispose();
    }
    this.mesh = next;
    this.samples = [];
    if (next) {
      next.removeFromParent();
      // The faces look at the camera that saw them: without their backs one looks into the room from outside.
      const material = next.material as MeshBasicMaterial;
      material.side = FrontSide;
      this.scene.add(next);
      this.samples = samplesOf(next);
    }
  }
}

/** Resolves when the browser has nothing else to do, after half a second at the latest. */
function idle(): Promise<unknown> {
  return new Promise((resolve) =>
    "requestIdleCallback" in globalThis ? requestIdleCallback(resolve, { timeout: 500 }) : setTimeout(resolve),
  );
}

/** Points of a mesh without its outermost vertices, which are often noise. */
function samplesOf(mesh: Mesh): Vector3[] {
  const positions = mesh.geometry.getAttribute("position");
  const step = Math.max(1, Math.floor(positions.count / SAMPLES));
  const points: Vector3[] = [];
  for (let vertex = 0; vertex < positions.count; vertex += step) {
    points.push(new Vector3().fromBufferAttribute(positions, vertex));
  }
  const box = new Box3();
  for (const axis of ["x", "y", "z"] as const) {
    const values = points.map((point) => point[axis]).sort((a, b) => a - b);
    box.min[axis] = values[Math.floor(OUTER * values.length)]!;
    box.max[axis] = values[Math.ceil((1 - OUTER) * values.length) - 1]!;
  }
  return points.filter((point) => box.containsPoint(point));
}
