// Functions that the browser test calls in its page. Radiances are the renderer's pixels: linear, 1.0 = 255.

import { RoomLight, RoomLightError, type Frame, type Light, type LightData, type Lights, type Vector } from "roomlight";
import { applyToScene, environmentTexture, removeFromScene, specularTexture } from "roomlight/three";
import { cameraImage, frameOfView } from "roomlight/webxr";
import * as THREE from "three";
import * as field from "../light_field.js";

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(32, 32);
renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
renderer.shadowMap.enabled = true;

/** Linear RGB of the middle pixel. */
function renderPixel(scene: THREE.Scene, camera: THREE.Camera): number[] {
  renderer.render(scene, camera);
  const gl = renderer.getContext();
  const pixel = new Uint8Array(4);
  gl.readPixels(16, 16, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  return [...pixel.subarray(0, 3)].map((value) => value / 255);
}

/** A camera at a distance from the origin that looks along a direction. */
function cameraAlong(direction: Vector, from_m = 0): THREE.PerspectiveCamera {
  const camera = new THREE.PerspectiveCamera(60, 1, 0.01, 50);
  const along = new THREE.Vector3(...direction);
  camera.up.set(0, Math.abs(along.y) > 0.9 ? 0 : 1, Math.abs(along.y) > 0.9 ? 1 : 0);
  camera.position.copy(along).multiplyScalar(-from_m);
  camera.lookAt(camera.position.clone().add(along));
  camera.updateMatrixWorld();
  return camera;
}

/** A disc at the origin that faces a direction. */
function disc(normal: Vector, material: THREE.Material): THREE.Mesh {
  const mesh = new THREE.Mesh(new THREE.CircleGeometry(1), material);
  mesh.lookAt(...normal);
  return mesh;
}

const opposite = (direction: Vector) => direction.map((part) => -part) as unknown as Vector;
const cube = () => field.binary("cube", field.cubeBytes(32));

/** Sample a texture like three.js's shaders: panoramas by its `equirectUv`, cubes with -x. */
function sampleTexture(map: THREE.Texture, directions: readonly Vector[], level = 0): number[][] {
  const material = new THREE.ShaderMaterial({
    uniforms: { map: { value: map }, direction: { value: new THREE.Vector3() }, level: { value: level } },
    vertexShader: "void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }",
    fragmentShader: (map as THREE.CubeTexture).isCubeTexture
      ? `uniform samplerCube map; uniform vec3 direction; uniform float level;
         void main() { gl_FragColor = textureLod(map, vec3(-direction.x, direction.yz), level); }`
      : `#include <common>
         uniform sampler2D map; uniform vec3 direction;
         void main() { gl_FragColor = texture2D(map, equirectUv(direction)); }`,
  });
  const scene = new THREE.Scene();
  const sheet = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
  sheet.frustumCulled = false;
  scene.add(sheet);
  return directions.map((direction) => {
    material.uniforms["direction"]!.value.set(...direction);
    return renderPixel(scene, cameraAlong([0, 0, -1]));
  });
}

/** Samples of a form `hdr`, and of a level of `specular`, in each direction. */
const panorama = () =>
  sampleTexture(environmentTexture(field.binary("hdr", field.hdrBytes(64, true))), field.DIRECTIONS);
function specular(level: number): number[][] {
  const levels = [field.cubeBytes(8), field.cubeBytes(4, 0.5), field.cubeBytes(2, 0.25)];
  return sampleTexture(specularTexture(field.binary("specular", field.ktx2Bytes(levels, 8))), field.DIRECTIONS, level);
}

/** A mirror that faces each direction, lit by an environment. */
function mirrored(): number[][] {
  const scene = new THREE.Scene();
  applyToScene(scene, field.light([cube(), field.harmonicsForm("arcore"), field.MAIN_LIGHT]));
  const mirror = disc([0, 0, 1], new THREE.MeshStandardMaterial({ metalness: 1, roughness: 0 }));
  scene.add(mirror);
  const pixels = field.DIRECTIONS.map((direction) => {
    mirror.lookAt(...direction);
    return renderPixel(scene, cameraAlong(opposite(direction), 3));
  });
  removeFromScene(scene);
  return pixels;
}

/** White diffuse discs in each direction, lit by harmonics at the origin and, if given, a main light. */
function diffuse(parts: readonly LightData[]): number[][] {
  return field.DIRECTIONS.map((direction) => {
    const scene = new THREE.Scene();
    applyToScene(scene, { ...field.light(parts), position: [0, 0, 0] });
    scene.add(disc(direction, new THREE.MeshLambertMaterial()));
    return renderPixel(scene, cameraAlong(opposite(direction), 3));
  });
}

/** A sphere in a frame's picture. */
export interface SphereView {
  position: Vector;
  radius_m: number;
  albedo: number;
  camera_to_world: number[];
  fov_degrees: number;
  width: number;
  height: number;
}

/** A matte sphere lit by any forms: RGB of all pixels, rows from the bottom. */
function sphere(light: Light, view: SphereView): number[] {
  const scene = new THREE.Scene();
  const { environment } = applyToScene(scene, light);
  const material = environment // which Lambert's material does not take
    ? new THREE.MeshPhysicalMaterial({ roughness: 1, specularIntensity: 0 })
    : new THREE.MeshLambertMaterial();
  material.color.setScalar(view.albedo);
  const ball = new THREE.Mesh(new THREE.SphereGeometry(view.radius_m, 128, 64), material);
  ball.position.set(...view.position);
  scene.add(ball);
  const camera = new THREE.PerspectiveCamera(view.fov_degrees, view.width / view.height, 0.01, 50);
  camera.applyMatrix4(new THREE.Matrix4().fromArray(view.camera_to_world));
  const target = new THREE.WebGLRenderTarget(view.width, view.height, { type: THREE.FloatType });
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const pixels = new Float32Array(4 * view.width * view.height);
  renderer.readRenderTargetPixels(target, 0, 0, view.width, view.height, pixels);
  renderer.setRenderTarget(null);
  target.dispose();
  return [...pixels].filter((_, at) => at % 4 < 3);
}

/** A floor of ShadowMaterial under a box and beside it, lit by an environment. */
function shadows(): number[][] {
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(1, 1, 1);
  const overhead = { ...field.MAIN_LIGHT, values: { direction: [0, 1, 0], intensity: [3, 3, 3], shadow_strength: 1 } };
  const { directional } = applyToScene(scene, { ...field.light([cube(), overhead]), position: [0, 0, 0] });
  directional.castShadow = true;
  const floor = disc([0, 1, 0], new THREE.ShadowMaterial({ opacity: 0.5 }));
  floor.receiveShadow = true;
  const box = new THREE.Mesh(new THREE.BoxGeometry(0.4, 0.1, 0.4), new THREE.MeshBasicMaterial());
  box.position.y = 2;
  box.castShadow = true;
  scene.add(floor, box);
  return [
    [0, 0],
    [0.7, 0],
  ].map(([x, z]) => {
    const camera = new THREE.PerspectiveCamera(5, 1, 0.1, 10);
    camera.position.set(x! + 1, 1, z!);
    camera.lookAt(x!, 0, z!);
    camera.updateMatrixWorld();
    return renderPixel(scene, camera);
  });
}

/** A texture of an image, lowest row first as in WebGL. */
function paintedTexture(
  gl: WebGL2RenderingContext,
  width: number,
  height: number,
  colourAt: (column: number, row: number) => readonly number[],
): WebGLTexture {
  const texture = gl.createTexture();
  const rgba = new Uint8Array(width * height * 4);
  for (let at = 0; at < width * height; at++) {
    rgba.set([...colourAt(at % width, Math.floor(at / width)), 255], 4 * at);
  }
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.bindTexture(gl.TEXTURE_2D, null);
  return texture;
}

/** A WebXR view of a room, left red, right green, top dark, 1.5 m away. */
function xrFrame(): Frame {
  const gl = renderer.getContext() as WebGL2RenderingContext;
  const [width, height] = [960, 720];
  const room = paintedTexture(gl, width, height, (column, row) => {
    const value = row < height / 2 ? 240 : 60;
    return column < width / 2 ? [value, 0, 0] : [0, value, 0];
  });
  gl.enable(gl.SCISSOR_TEST);
  gl.scissor(0, 0, 1, 1);
  const image = cameraImage(gl, room, { width, height }, { longest: 320 });
  gl.disable(gl.SCISSOR_TEST);
  renderer.resetState();
  const view = new THREE.PerspectiveCamera(50, 4 / 3, 0.1, 10);
  const depth = {
    width: 40,
    height: 30,
    data: new Uint16Array(1200).fill(1500).buffer,
    rawValueToMeters: 0.001,
    normDepthBufferFromNormView: { matrix: new THREE.Matrix4().elements },
  };
  const pose = {
    projectionMatrix: view.projectionMatrix.elements,
    transform: { matrix: new THREE.Matrix4().elements },
  };
  return frameOfView({ view: pose, depth, image, time_ms: performance.now() });
}

/** An image of `cameraImage`, decoded. */
async function drawn(image: Promise<Blob>): Promise<OffscreenCanvasRenderingContext2D> {
  const bitmap = await createImageBitmap(await image);
  const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d")!;
  context.drawImage(bitmap, 0, 0);
  return context;
}

/** The middle pixel of an eighth of the size, where one column in eight is white: the first, the second, and so on. */
function stripes(): Promise<number[]> {
  const gl = renderer.getContext() as WebGL2RenderingContext;
  const [width, height] = [256, 192];
  const shown = Array.from({ length: 8 }, async (_, white) => {
    const texture = paintedTexture(gl, width, height, (column) => Array(3).fill(column % 8 === white ? 255 : 0));
    const context = await drawn(cameraImage(gl, texture, { width, height }, { longest: width / 8 }).data);
    return context.getImageData(16, 12, 1, 1).data[0]!;
  });
  renderer.resetState();
  return Promise.all(shown);
}

/** The middle pixels of the image's quarters: top left, top right, bottom left, bottom right. */
async function quarters(): Promise<{ size: number[]; pixels: number[][] }> {
  const context = await drawn(xrFrame().colour.data as Promise<Blob>);
  const { width, height } = context.canvas;
  const pixel = (x: number, y: number) => [...context.getImageData(x * width, y * height, 1, 1).data.subarray(0, 3)];
  return {
    size: [width, height],
    pixels: [pixel(0.25, 0.25), pixel(0.75, 0.25), pixel(0.25, 0.75), pixel(0.75, 0.75)],
  };
}

/** A session from another origin, over HTTP and WebSocket, with its light in a scene. */
async function session(url: string, token: string, vector: readonly Frame[]) {
  const server = new RoomLight(url, { token });
  const options = { model: "classical", height: 32, reference_exposure: 1, use_limited_tracking: true } as const;
  const shared = await server.open(options);
  const statuses: string[] = [];
  for (const { colour, depth, confidence, ...rest } of vector) {
    const frame: Frame = {
      ...rest,
      colour: withBytes(colour),
      depth: depth && withBytes(depth),
      confidence: confidence && withBytes(confidence),
    };
    statuses.push((await shared.push(frame)).status);
  }
  await shared.delete();
  const gone = await shared.state().then(
    () => 0,
    (error: RoomLightError) => error.status,
  );

  const live = await server.open(options);
  let tracked: Light | null = null;
  const update = new Promise<Lights>((resolve) => {
    void live.stream({ onLighting: (lights) => lights.frame < 0 || resolve(lights) }).then(async (stream) => {
      stream.track("here", [0, 0, -0.5]);
      stream.subscribe([{ format: "cube", size: 32 }, { format: "sh" }, { format: "main_light" }]);
      statuses.push((await stream.push(xrFrame())).status);
    });
  });
  tracked = (await update).results[0]!;
  const first = await live.probe("here", { format: "sh" });
  const again = await live.probe("here", { format: "sh" }, { etag: first!.etag });
  const scene = new THREE.Scene();
  const { environment } = applyToScene(scene, tracked);
  const ahead = sampleTexture(environment!, [field.unit([-0.3, 0, -1]), field.unit([0.3, 0, -1])]);
  await live.delete();
  return { statuses, gone, ahead, coverage: tracked.coverage, unchanged: again === null };
}

const withBytes = <Part extends { data: unknown }>(part: Part) => ({
  ...part,
  data: Uint8Array.from(part.data as number[]),
});

const calls = {
  ...{ mirrored, panorama, diffuse, sphere, specular, shadows, stripes, quarters, session },
  harmonicsForm: field.harmonicsForm,
};
export type Calls = typeof calls;
Object.assign(globalThis, { calls });
