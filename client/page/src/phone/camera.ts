// The sender without WebXR: photos of the plain camera, each for the light of a single image.

import { RoomLightError, type Frame } from "roomlight";
import type { PhotoLink } from "./link";

const LONGEST = 640;
const LONG_SIDE_FOV_DEG = 66; // a phone's main camera; browsers do not tell
const SPACING_S = 2;
const HIDDEN = "This browser hides the pixels of pictures: allow canvas data for this site.";

/** Open the camera that looks away from the user. Throws DOMException if there is none or it is refused. */
export function openCamera(): Promise<MediaStream> {
  return navigator.mediaDevices.getUserMedia({
    audio: false,
    video: { facingMode: { ideal: "environment" }, width: { ideal: 1280 }, height: { ideal: 720 } },
  });
}

/** Send photos until the signal is aborted. Throws RoomLightError if the server refuses them for good. */
export async function sendPhotos(video: HTMLVideoElement, link: PhotoLink, signal: AbortSignal): Promise<void> {
  while (!signal.aborted) {
    try {
      await link.send(await photoOf(video), signal);
    } catch (error) {
      if (signal.aborted) {
        break;
      }
      if (error instanceof RoomLightError && error.status >= 400 && error.status < 500 && error.status !== 429) {
        throw error;
      }
      link.failed(error instanceof Error ? error : new Error(String(error)));
    }
    await pause(SPACING_S, signal);
  }
  link.close();
}

/** The video's picture as a frame without depth: level camera at the origin. Throws if the browser gives noise instead. */
async function photoOf(video: HTMLVideoElement): Promise<Frame> {
  const scale = Math.min(1, LONGEST / Math.max(video.videoWidth, video.videoHeight));
  const [width, height] = [Math.round(video.videoWidth * scale), Math.round(video.videoHeight * scale)];
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d")!;
  context.drawImage(video, 0, 0, width, height);
  if (context.getImageData(0, 0, 1, 1).data[3] !== 255) {
    throw new Error(HIDDEN);
  }
  const data = await canvas.convertToBlob({ type: "image/jpeg", quality: 0.85 });
  const focal = Math.max(width, height) / 2 / Math.tan((LONG_SIDE_FOV_DEG / 2) * (Math.PI / 180));
  return {
    colour: { encoding: "jpeg", data },
    intrinsics: { fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height },
    camera_to_world: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  };
}

function pause(seconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const end = () => (clearTimeout(timer), resolve());
    const timer = setTimeout(() => (signal.removeEventListener("abort", end), resolve()), seconds * 1000);
    signal.addEventListener("abort", end, { once: true });
  });
}
