// The sender with WebXR: camera image, depth and pose of each view, in metres, y up.

import { cameraImage, frameOfView } from "roomlight/webxr";
import type { StreamLink } from "./link";

const SPACING_MS = 150; // more than six frames a second show the same room
const AHEAD_M = 0.6; // in free space even where the phone is held in front of a wall

/** A view with the camera-access module's member. */
type CameraView = XRView & { readonly camera?: { readonly width: number; readonly height: number } };
type CameraBinding = XRWebGLBinding & { getCameraImage(camera: object): WebGLTexture | null };

/** Whether this browser offers AR sessions at all; camera access shows only when one starts. */
export async function hasAugmentedReality(): Promise<boolean> {
  try {
    return (await navigator.xr?.isSessionSupported("immersive-ar")) ?? false;
  } catch {
    return false; // the page may not use WebXR here
  }
}

/** Ask for an AR session with the camera's image. Must be called from a click. Rejects if the phone refuses it. */
export function requestCameraSession(overlay: HTMLElement): Promise<XRSession> {
  return navigator.xr!.requestSession("immersive-ar", {
    requiredFeatures: ["camera-access", "local"],
    optionalFeatures: ["depth-sensing", "local-floor", "dom-overlay"],
    domOverlay: { root: overlay },
    depthSensing: {
      usagePreference: ["cpu-optimized"],
      dataFormatPreference: ["luminance-alpha", "float32"],
    },
  } as XRSessionInit);
}

/** Send frames until the session ends. `noDepth` is called once if the phone measures none. Rejects if a frame fails. */
export async function sendViews(session: XRSession, link: StreamLink, noDepth: () => void): Promise<void> {
  const canvas = document.createElement("canvas");
  const gl = canvas.getContext("webgl2", { xrCompatible: true, alpha: true })!;
  await gl.makeXRCompatible();
  await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
  const binding = new XRWebGLBinding(session, gl) as CameraBinding;
  const space = await session
    .requestReferenceSpace("local-floor")
    .catch(() => session.requestReferenceSpace("local"));
  let last_ms = -Infinity;
  let placed = false;
  let measured: boolean | null = null;
  const draw = (time_ms: number, frame: XRFrame) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, session.renderState.baseLayer!.framebuffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT); // the camera's picture shows through
    const pose = frame.getViewerPose(space);
    const view = pose?.views[0] as CameraView | undefined;
    if (!pose || !view?.camera || !link.isFree || time_ms - last_ms < SPACING_MS) {
      return;
    }
    const texture = binding.getCameraImage(view.camera);
    if (!texture) {
      return;
    }
    last_ms = time_ms;
    const image = cameraImage(gl, texture, view.camera);
    const { emulatedPosition } = pose;
    const message = frameOfView({ view, xrFrame: frame, image, time_ms, emulatedPosition });
    if (measured === null && !message.depth) {
      noDepth();
    }
    measured ??= Boolean(message.depth);
    if (!message.depth && measured) {
      return; // a gap of the sensor: the next frame has depth again
    }
    if (!placed) {
      link.follow(pointAhead(view.transform.matrix));
      placed = true;
    }
    void link.send(message);
  };
  await new Promise<void>((resolve, reject) => {
    const next = (time_ms: number, frame: XRFrame) => {
      try {
        draw(time_ms, frame);
        session.requestAnimationFrame(next);
      } catch (error) {
        reject(error); // the browser would only log it
      }
    };
    session.addEventListener("end", () => resolve(), { once: true });
    session.requestAnimationFrame(next);
  });
}

/** The point in front of the first view: the camera looks along its negative z axis. */
function pointAhead(matrix: ArrayLike<number>): [number, number, number] {
  return [0, 1, 2].map((axis) => matrix[12 + axis]! - AHEAD_M * matrix[8 + axis]!) as [number, number, number];
}
