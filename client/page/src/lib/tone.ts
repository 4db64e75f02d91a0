// Pixels of a panorama for the screen: sRGB at an exposure, or false colour of luminance.

import type { LightSourceValues, Panorama } from "roomlight";

/** Stops above and below white that the false colours span. */
export const FALSE_COLOUR_STOPS = 6;

const SRGB = new Uint8Array(4097).map((_, at) => {
  const linear = at / 4096;
  return Math.round(255 * (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055));
});

export interface ToneOptions {
  readonly exposureEv: number;
  readonly falseColour: boolean;
  /** Where a colour is mixed in: 255 none, 0 most; null nowhere. */
  readonly seen: Uint8ClampedArray | null;
  readonly tint: readonly [number, number, number];
}

/** Eight-bit sRGB of linear radiance. */
export function toneMapped({ width, height, rgb }: Panorama, options: ToneOptions): ImageData {
  const image = new ImageData(width, height);
  const { data } = image;
  const gain = 2 ** options.exposureEv;
  for (let pixel = 0; pixel < width * height; pixel++) {
    const [red, green, blue] = [rgb[3 * pixel]! * gain, rgb[3 * pixel + 1]! * gain, rgb[3 * pixel + 2]! * gain];
    const colour = options.falseColour ? turbo(position(luminance(red, green, blue))) : [srgb(red), srgb(green), srgb(blue)];
    const unseen = options.seen ? 0.6 * (1 - options.seen[pixel]! / 255) : 0;
    for (let channel = 0; channel < 3; channel++) {
      data[4 * pixel + channel] = colour[channel]! * (1 - unseen) + options.tint[channel]! * unseen;
    }
    data[4 * pixel + 3] = 255;
  }
  return image;
}

export function luminance(red: number, green: number, blue: number): number {
  return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
}

/** The exposure at which the panorama's 90th percentile of luminance is 0.8 of white. */
export function autoExposure({ width, height, rgb }: Panorama): number {
  const values = Float32Array.from({ length: width * height }, (_, pixel) =>
    luminance(rgb[3 * pixel]!, rgb[3 * pixel + 1]!, rgb[3 * pixel + 2]!),
  ).sort();
  const bright = values[Math.floor(0.9 * (values.length - 1))]!;
  const ev = bright > 0 ? Math.log2(0.8 / bright) : 0;
  return Math.min(8, Math.max(-8, Math.round(4 * ev) / 4));
}

/** The largest channel of a light's irradiance. */
export function strengthOf(light: LightSourceValues): number {
  return Math.max(...light.intensity);
}

/** The hue of a light at full brightness, as a colour of CSS. */
export function hueOf(light: LightSourceValues): string {
  const strength = strengthOf(light) || 1;
  return `rgb(${light.intensity.map((value) => srgb(value / strength)).join(",")})`;
}

function srgb(linear: number): number {
  return SRGB[Math.min(4096, Math.max(0, Math.round(linear * 4096)))]!;
}

/** Position on the scale of false colours, 0 to 1; white is 0.5. */
function position(value: number): number {
  const stops = value > 0 ? Math.log2(value) : -Infinity;
  return Math.min(1, Math.max(0, 0.5 + stops / (2 * FALSE_COLOUR_STOPS)));
}

/** Google's Turbo colour map, polynomial approximation of Anton Mikhailov (Apache-2.0); 0 to 255. */
export function turbo(x: number): [number, number, number] {
  const polynomial = (...c: number[]) => 255 * Math.min(1, Math.max(0, c.reduceRight((sum, factor) => sum * x + factor, 0)));
  return [
    polynomial(0.13572138, 4.6153926, -42.66032258, 132.13108234, -152.94239396, 59.28637943),
    polynomial(0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604),
    polynomial(0.1066733, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973),
  ];
}
