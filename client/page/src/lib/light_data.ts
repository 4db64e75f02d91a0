// The light of a probe as the page needs it, from the forms that it asks for.

import { findForm, Harmonics, parseHdr, type Light, type LightForm, type MainLightValues } from "roomlight";
import { timed } from "./parts";
import type { ProbeLight } from "../state";

/** The forms of each probe that the page asks for. */
export const FORMS: readonly LightForm[] = [
  { format: "hdr", use: "reflection" }, // shown as a panorama and in mirror spheres
  { format: "confidence" },
  { format: "main_light" },
  { format: "sh", basis: "threejs" },
];

export async function probeLight(name: string, frame: number, light: Light): Promise<ProbeLight> {
  const hdr = findForm(light, "hdr")?.data;
  const confidence = findForm(light, "confidence")?.data;
  const main = findForm(light, "main_light")?.values as unknown as MainLightValues | undefined;
  const sh = findForm(light, "sh");
  return {
    name,
    frame,
    position: light.position,
    coverage: light.coverage,
    panorama: hdr ? timed("decode light", () => parseHdr(hdr)) : null,
    seen: confidence ? await greyOf(confidence) : null,
    harmonics: sh ? Harmonics.of(sh).coefficients.flat() : null,
    lights: main?.lights ?? [],
  };
}

/** The first channel of an opaque PNG; null where the browser gives noise in place of pixels. */
async function greyOf(png: Uint8Array<ArrayBuffer>): Promise<Uint8ClampedArray | null> {
  const image = await createImageBitmap(new Blob([png], { type: "image/png" }));
  const canvas = new OffscreenCanvas(image.width, image.height);
  const context = canvas.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(image, 0, 0);
  image.close();
  const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
  const isOpaque = data.every((value, at) => at % 4 !== 3 || value === 255);
  return isOpaque ? data.filter((_, at) => at % 4 === 0) : null;
}
