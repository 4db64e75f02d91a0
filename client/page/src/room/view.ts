// The 3D view: renderer, camera and turning it. It draws only when something has changed.

import {
  Box2,
  Box3,
  PerspectiveCamera,
  PMREMGenerator,
  Raycaster,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
  type Matrix4,
  type Texture,
  type WebGLRenderTarget,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { onThemeChange, themeColour } from "../lib/dom";
import { Drawing } from "../lib/drawing";
import { Resolution } from "./resolution";

const FILLED = 0.94; // of the view by the points of `lookAt`
const DATA_MS = 60; // changes that frames bring within this time are drawn together
const SOFTWARE_DATA_MS = 200; // the same, without a graphics processor
const SOFTWARE_RENDERERS = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const TURN_STEP = Math.PI / 24; // of an arrow key

export class RoomView {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(50, 1, 0.02, 200);
  readonly controls: OrbitControls;
  frames = 0;
  /** Whether the browser draws without a graphics processor. */
  readonly isSoftware: boolean;
  private readonly renderer: WebGLRenderer;
  private readonly environments: PMREMGenerator;
  private readonly drawing: Drawing;
  private readonly resolution: Resolution;
  private factor = 1; // of the resolution
  private moves = false; // whether the next drawing shows what the visitor moves

  /** For the reflections of three.js's materials, of a panorama of the light: its `texture` is the `envMap`. */
  environmentOf(panorama: Texture): WebGLRenderTarget {
    return this.environments.fromEquirectangular(panorama);
  }

  /** Throws an Error if the browser has no WebGL 2. */
  constructor(private readonly canvas: HTMLCanvasElement) {
    this.isSoftware = isSoftware();
    this.resolution = new Resolution(() => this.drawing.request(), this.isSoftware);
    // Without a graphics processor antialiasing takes most of the time, and a transparent canvas costs more than an opaque one.
    const context = canvas.getContext("webgl2", { alpha: false, antialias: !this.isSoftware });
    if (!context) {
      throw new Error("the browser has no WebGL 2");
    }
    this.renderer = new WebGLRenderer({ canvas, context });
    this.environments = new PMREMGenerator(this.renderer);
    this.drawing = new Drawing(canvas, "3D view", (now_ms) => this.render(now_ms));
    this.paintBackground();
    onThemeChange(() => this.paintBackground());
    canvas.addEventListener("webglcontextrestored", () => this.paintBackground()); // three.js has begun anew by then
    this.camera.position.set(3, 3, 4);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("keydown", (event) => this.onKey(event));
    this.resize();
  }

  private paintBackground(): void {
    this.renderer.setClearColor(themeColour("--sunken"));
    this.drawSoon();
  }

  /** Draw with the next frame of the screen: for what the visitor does. */
  draw(): void {
    this.moves = true;
    this.drawing.request();
  }

  /** Draw soon: for what a frame of the stream brings, in several answers. */
  drawSoon(): void {
    this.drawing.requestWithin(this.isSoftware ? SOFTWARE_DATA_MS : DATA_MS);
  }

  private render(now_ms: number): void {
    const factor = this.resolution.next(now_ms, this.moves);
    this.moves = false;
    if (factor !== this.factor) {
      this.factor = factor;
      this.renderer.setPixelRatio(this.pixelRatio);
    }
    this.renderer.render(this.scene, this.camera);
    this.frames++;
  }

  private get pixelRatio(): number {
    return this.factor * Math.min(devicePixelRatio, 2);
  }

  /** A ray through a point of the window. */
  rayAt(clientX: number, clientY: number): Raycaster {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const ray = new Raycaster();
    this.camera.updateMatrixWorld(); // it may have been turned since the last drawing
    const point = new Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
    ray.setFromCamera(point, this.camera);
    return ray;
  }

  /** Where a point of the world is in the window. */
  project(point: Vector3): { x: number; y: number } {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    this.camera.updateMatrixWorld();
    const { x, y } = point.clone().project(this.camera);
    return { x: left + ((x + 1) / 2) * width, y: top + ((1 - y) / 2) * height };
  }

  /** Look at points from above, from the side where `from` is, so that they fill the view. */
  lookAt(points: readonly Vector3[], from: Vector3): void {
    const centre = new Box3().setFromPoints([...points]).getCenter(new Vector3());
    const away = from.clone().sub(centre).setY(0);
    if (away.length() < 0.2) {
      away.set(0.6, 0, 1);
    }
    away.normalize().setY(0.6).normalize();
    const right = new Vector3().crossVectors(new Vector3(0, 1, 0), away).normalize();
    const up = new Vector3().crossVectors(away, right);
    const tangent = FILLED * Math.tan((this.camera.fov * Math.PI) / 360);
    let distance = 0;
    for (let pass = 0; pass < 3; pass++) {
      const seen = new Box2();
      distance = 0.5;
      for (const point of points) {
        const at = point.clone().sub(centre);
        const [x, y, z] = [at.dot(right), at.dot(up), at.dot(away)];
        distance = Math.max(distance, z + Math.max(Math.abs(x) / this.camera.aspect, Math.abs(y)) / tangent);
        seen.expandByPoint(new Vector2(x, y));
      }
      const middle = seen.getCenter(new Vector2());
      centre.addScaledVector(right, middle.x).addScaledVector(up, middle.y);
    }
    this.camera.position.copy(centre).addScaledVector(away, distance);
    this.controls.target.copy(centre);
    this.controls.update();
    this.draw();
  }

  /** Look through the camera at `pose`. */
  lookFrom(pose: Matrix4): void {
    this.camera.position.setFromMatrixPosition(pose);
    const forward = new Vector3().setFromMatrixColumn(pose, 2).negate();
    this.controls.target.copy(this.camera.position).addScaledVector(forward, 1.5);
    this.controls.update();
    this.draw();
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width > 0 && height > 0) {
      this.renderer.setPixelRatio(this.pixelRatio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.render(performance.now()); // at once: a resized canvas is empty
    }
  }

  private onKey(event: KeyboardEvent): void {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const up = new Vector3(0, 1, 0);
    const right = new Vector3().crossVectors(up, offset).normalize();
    const turns: Record<string, () => void> = {
      ArrowLeft: () => offset.applyAxisAngle(up, -TURN_STEP),
      ArrowRight: () => offset.applyAxisAngle(up, TURN_STEP),
      ArrowUp: () => offset.angleTo(up) > 0.15 && offset.applyAxisAngle(right, -TURN_STEP),
      ArrowDown: () => offset.angleTo(up) < Math.PI - 0.15 && offset.applyAxisAngle(right, TURN_STEP),
      "+": () => offset.multiplyScalar(0.9),
      "-": () => offset.multiplyScalar(1 / 0.9),
    };
    const turn = turns[event.key];
    if (turn) {
      event.preventDefault();
      turn();
      this.camera.position.copy(this.controls.target).add(offset);
      this.controls.update();
      this.draw();
    }
  }
}

/** Whether WebGL draws without a graphics processor. Browsers do not always call that a performance caveat. */
function isSoftware(): boolean {
  const context = document.createElement("canvas").getContext("webgl2", { failIfMajorPerformanceCaveat: true });
  const names = context?.getExtension("WEBGL_debug_renderer_info");
  const renderer = String(context?.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER) ?? "");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context === null || SOFTWARE_RENDERERS.test(renderer);
}
