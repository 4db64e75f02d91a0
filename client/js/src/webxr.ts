// Convert WebXR frames: view, CPU depth (depth-sensing) and camera image (camera-access) become a frame to send. The
// interfaces are the parts of WebXR's types that are read here, so apps need no type package; XRView etc. satisfy them.

import type { Frame } from "./frame.js";
import type { WireIntrinsics } from "./wire.js";

type Matrix = ArrayLike<number>; // 16 numbers, column by column

/** `XRView`, in the reference space of the light's positions (e.g. `local`): metres, y up. */
export interface ViewLike {
  readonly projectionMatrix: Matrix;
  readonly transform: { readonly matrix: Matrix };
}

/** `XRCPUDepthInformation` of a session with `cpu-optimized` depth, in any of the three formats. */
export interface CpuDepthLike {
  readonly data: ArrayBuffer;
  readonly width: number;
  readonly height: number;
  readonly rawValueToMeters: number;
  readonly normDepthBufferFromNormView: { readonly matrix: Matrix };
}

/** `XRFrame`, of which only the depth is read. */
export interface FrameLike {
  getDepthInformation?(view: ViewLike): CpuDepthLike | null | undefined;
}

/** An encoded image of the view: a JPEG from `cameraImage`, or from any canvas that shows exactly the view. */
export interface ViewImage {
  readonly data: Blob | ArrayBuffer | Uint8Array | Promise<Blob>;
  readonly width: number;
  readonly height: number;
  readonly encoding?: "jpeg" | "png" | undefined;
}

export interface ViewFrame {
  view: ViewLike;
  /** Gives the view's depth, if the session has depth-sensing and the phone measures any. */
  xrFrame?: FrameLike | undefined;
  /** Instead of `xrFrame`: the view's depth, or a map of the image's view. Without depth the server estimates it. */
  depth?: CpuDepthLike | Frame["depth"];
  image: ViewImage;
  /** `XRFrame.predictedDisplayTime`, or the callback's time, in milliseconds. */
  time_ms?: number | undefined;
  /** `XRViewerPose.emulatedPosition`: tracking is lost, and the position is a guess. */
  emulatedPosition?: boolean | undefined;
  exposure?: number | undefined;
}

/** The frame to push for one animation frame of WebXR. Everything is copied before this returns. */
export function frameOfView({
  view,
  xrFrame,
  depth = measuredDepth(xrFrame, view),
  image,
  time_ms,
  emulatedPosition = false,
  exposure,
}: ViewFrame): Frame {
  return {
    colour: { encoding: image.encoding ?? "jpeg", data: image.data },
    ...(depth ? { depth: "rawValueToMeters" in depth ? depthOfView(depth, image) : depth } : {}),
    intrinsics: intrinsicsOfView(view.projectionMatrix, image),
    camera_to_world: Array.from(view.transform.matrix),
    tracking_state: emulatedPosition ? "limited" : "normal",
    ...(time_ms === undefined ? {} : { timestamp_s: time_ms / 1000 }),
    ...(exposure === undefined ? {} : { exposure }),
  };
}

function measuredDepth(xrFrame: FrameLike | undefined, view: ViewLike): CpuDepthLike | null | undefined {
  try {
    return xrFrame?.getDepthInformation?.(view);
  } catch {
    return null; // the session has no depth-sensing, or only the GPU's
  }
}

/**
 * The pinhole camera of a projection matrix, for an image of the whole view with the top row first.
 *
 * Clip x = (p0 X + p8 Z) / -Z spans -1 .. 1 over the width, clip y = (p5 Y + p9 Z) / -Z over the height, upward.
 */
export function intrinsicsOfView(
  projection: Matrix,
  { width, height }: { width: number; height: number },
): WireIntrinsics {
  const p = (index: number) => projection[index]!;
  if (projection.length !== 16 || Math.abs(p(4)) > 1e-6 * p(0) || p(11) !== -1) {
    throw new RangeError(`expected a perspective projection without skew, got ${Array.from(projection)}`);
  }
  return {
    fx: (width / 2) * p(0),
    fy: (height / 2) * p(5),
    cx: (width / 2) * (1 - p(8)),
    cy: (height / 2) * (1 + p(9)),
    width,
    height,
  };
}

/**
 * The depth of the view, upright and with the image's aspect, with the values of
 * `XRCPUDepthInformation.getDepthInMeters`.
 *
 * Depth buffers have the orientation of the sensor, rotated by 90 degrees from a phone held upright, and cover more or
 * less than the view. Values are sampled without interpolation, because a depth between two surfaces would be wrong;
 * outside the buffer they are 0 (unknown).
 */
export function depthOfView(info: CpuDepthLike, image: { width: number; height: number }): NonNullable<Frame["depth"]> {
  const texels = info.width * info.height;
  const isFloat = info.data.byteLength === 4 * texels;
  if (!isFloat && info.data.byteLength !== 2 * texels) {
    throw new RangeError(
      `depth of ${info.width} x ${info.height} must have 2 or 4 bytes a value, got ${info.data.byteLength} bytes`,
    );
  }
  const raw = isFloat ? new Float32Array(info.data) : new Uint16Array(info.data);
  const longest = Math.max(info.width, info.height);
  const scale = longest / Math.max(image.width, image.height);
  const [width, height] = [Math.max(Math.round(image.width * scale), 2), Math.max(Math.round(image.height * scale), 2)];
  const isMillimetres = !isFloat && Math.abs(info.rawValueToMeters * 1000 - 1) < 1e-6;
  const data = isMillimetres ? new Uint16Array(width * height) : new Float32Array(width * height);
  const m = info.normDepthBufferFromNormView.matrix as ArrayLike<number> & { [at: number]: number };
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const [x, y] = [(column + 0.5) / width, (row + 0.5) / height]; // of the view, origin top left
      const [bufferX, bufferY] = [m[0]! * x + m[4]! * y + m[12]!, m[1]! * x + m[5]! * y + m[13]!];
      if (bufferX >= 0 && bufferX < 1 && bufferY >= 0 && bufferY < 1) {
        const value = raw[Math.floor(bufferY * info.height) * info.width + Math.floor(bufferX * info.width)]!;
        data[row * width + column] = isMillimetres ? value : value * info.rawValueToMeters;
      }
    }
  }
  return { format: isMillimetres ? "uint16_mm" : "float32_m", encoding: "raw", width, height, data };
}

/**
 * The camera image of a view as a JPEG: `cameraImage(gl, binding.getCameraImage(view.camera), view.camera)`.
 *
 * The texture is read before this returns, as WebXR requires. The JPEG is encoded later, so `data` is a promise, which
 * `packFrame` awaits. `longest`: longest side in pixels; larger images are scaled down to it. The server works at
 * 320 x 240, and 640 keeps lamps sharp. Tested with textures in a browser, not with a phone's camera.
 */
export function cameraImage(
  gl: WebGL2RenderingContext,
  texture: WebGLTexture,
  camera: { readonly width: number; readonly height: number },
  { longest = 640, quality = 0.85 }: { longest?: number; quality?: number } = {},
): ViewImage & { data: Promise<Blob> } {
  const scale = Math.min(1, longest / Math.max(camera.width, camera.height));
  const [width, height] = [Math.round(camera.width * scale), Math.round(camera.height * scale)];
  const image = new ImageData(readTexture(gl, texture, camera, { width, height }), width, height);
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d")!.putImageData(image, 0, 0);
  return { data: canvas.convertToBlob({ type: "image/jpeg", quality }), width, height, encoding: "jpeg" };
}

type Size = { readonly width: number; readonly height: number };

/**
 * RGBA of a texture, top row first, scaled on the GPU. Restores the framebuffers in use.
 *
 * A linear blit averages 2 x 2 pixels, so none scales by more than 2: the first to the size times a power of two, the
 * others by exact halves.
 */
function readTexture(
  gl: WebGL2RenderingContext,
  texture: WebGLTexture,
  from: Size,
  to: Size,
): Uint8ClampedArray<ArrayBuffer> {
  const [readFramebuffer, drawFramebuffer] = [
    gl.getParameter(gl.READ_FRAMEBUFFER_BINDING),
    gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING),
  ];
  const renderbuffer = gl.getParameter(gl.RENDERBUFFER_BINDING);
  const scissorTest = gl.isEnabled(gl.SCISSOR_TEST); // it would clip the copy
  let [source, target] = [gl.createFramebuffer(), gl.createFramebuffer()];
  let [sourcePixels, targetPixels] = [gl.createRenderbuffer(), gl.createRenderbuffer()];
  const rgba = new Uint8ClampedArray(to.width * to.height * 4);
  try {
    gl.disable(gl.SCISSOR_TEST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, source);
    gl.framebufferTexture2D(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    if (gl.checkFramebufferStatus(gl.READ_FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) {
      throw new RangeError(`the camera texture cannot be read: ${gl.checkFramebufferStatus(gl.READ_FRAMEBUFFER)}`);
    }
    let { width, height } = from;
    const ratio = Math.max(width / to.width, height / to.height);
    for (let factor = 2 ** Math.max(Math.ceil(Math.log2(ratio)) - 1, 0); factor >= 1; factor /= 2) {
      const [toWidth, toHeight] = [to.width * factor, to.height * factor];
      const [bottom, top] = factor === 1 ? [toHeight, 0] : [0, toHeight]; // GL's rows go up, an image's rows go down
      gl.bindRenderbuffer(gl.RENDERBUFFER, targetPixels);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, toWidth, toHeight);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target);
      gl.framebufferRenderbuffer(gl.DRAW_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, targetPixels);
      gl.blitFramebuffer(0, 0, width, height, 0, bottom, toWidth, top, gl.COLOR_BUFFER_BIT, gl.LINEAR);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, target);
      [source, target, sourcePixels, targetPixels] = [target, source, targetPixels, sourcePixels];
      [width, height] = [toWidth, toHeight];
    }
    gl.readPixels(0, 0, to.width, to.height, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
  } finally {
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, readFramebuffer);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, drawFramebuffer);
    gl.bindRenderbuffer(gl.RENDERBUFFER, renderbuffer);
    if (scissorTest) {
      gl.enable(gl.SCISSOR_TEST);
    }
    [source, target].forEach((framebuffer) => gl.deleteFramebuffer(framebuffer));
    [sourcePixels, targetPixels].forEach((pixels) => gl.deleteRenderbuffer(pixels));
  }
  return rgba;
}
