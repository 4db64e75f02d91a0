// L2 spherical harmonics of radiance with the signs of three.js: Y00 Y1-1 Y10 Y11 Y2-2 Y2-1 Y20 Y21 Y22 over 1, y, z,
// x, xy, yz, 3z2-1, xz, x2-y2, all positive. The bases `arcore` and `arkit` include the Condon-Shortley phase: their terms
// of odd m (y, x, yz, xz) have the opposite sign.

import type { LightData } from "./light.js";

export type Vector = readonly [number, number, number];

/** The values of a form `sh`. */
export interface HarmonicsValues {
  coefficients: readonly number[];
  layout: "interleaved" | "planar";
  phase: "condon-shortley" | "positive";
  quantity: "radiance" | "irradiance";
  kind: "total" | "ambient";
}

/** One light: unit direction toward it; RGB irradiance on a surface that faces it. */
export interface LightSourceValues {
  direction: Vector;
  intensity: Vector;
  /** Angular radius in degrees of a round light of the same spread. */
  radius_deg: number;
  /** Share of the irradiance on a surface that faces the light, 0 to 1: how much darker its shadow is there. */
  shadow_strength: number;
  /** 1: brighter than any surface that the room's light explains; toward 0: it may be a bright surface. */
  emitted: number;
  /** Equal from frame to frame at a tracked probe. */
  number: number;
}

/** The values of a form `main_light`. */
export interface MainLightValues extends LightSourceValues {
  /**
   * Up to three lights, the strongest first. At a tracked probe the main light turns from one to another at a bounded
   * rate, while these stay in their places.
   */
  lights: readonly LightSourceValues[];
}

const ODD_M: readonly number[] = [1, 3, 5, 7]; // m = -1, 1, -1, 1
/** The cosine lobe's factor for each term. */
const COSINE_LOBE = [Math.PI, ...Array<number>(3).fill((2 * Math.PI) / 3), ...Array<number>(5).fill(Math.PI / 4)];

/** The nine basis functions at a unit direction. */
function evaluateBasis([x, y, z]: Vector): number[] {
  const [c0, c1, c2] = [Math.sqrt(1 / (4 * Math.PI)), Math.sqrt(3 / (4 * Math.PI)), Math.sqrt(15 / (4 * Math.PI))];
  const [c3, c4] = [Math.sqrt(5 / (16 * Math.PI)), Math.sqrt(15 / (16 * Math.PI))];
  return [c0, c1 * y, c1 * z, c1 * x, c2 * x * y, c2 * y * z, c3 * (3 * z * z - 1), c2 * x * z, c4 * (x * x - y * y)];
}

/** Nine RGB coefficients. */
export class Harmonics {
  constructor(readonly coefficients: readonly Vector[]) {}

  /** Harmonics of a form `sh` in any basis. Throws RangeError for any other form. */
  static of(form: LightData): Harmonics {
    const { coefficients, layout, phase, quantity } = (form.values ?? {}) as Partial<HarmonicsValues>;
    if (form.format !== "sh" || coefficients?.length !== 27 || !layout || !phase || quantity !== "radiance") {
      throw new RangeError(`expected a form sh with 27 radiance coefficients, layout and phase, got ${form.format}`);
    }
    const coefficient = (term: number, channel: number) =>
      coefficients[layout === "planar" ? channel * 9 + term : term * 3 + channel]!;
    const sign = (term: number) => (phase === "condon-shortley" && ODD_M.includes(term) ? -1 : 1);
    return new Harmonics(
      Array.from(
        { length: 9 },
        (_, term) => [0, 1, 2].map((channel) => sign(term) * coefficient(term, channel)) as unknown as Vector,
      ),
    );
  }

  /** These harmonics minus a directional light's, intensity x basis(direction): exactly the server's `kind=ambient`. */
  without(direction: Vector, intensity: Vector): Harmonics {
    const delta = evaluateBasis(direction);
    return this.map((value, term, channel) => value - delta[term]! * intensity[channel]!);
  }

  /** Radiance along a unit direction. It may be negative next to a lamp, because nine harmonics ring. */
  radiance(direction: Vector): Vector {
    const weights = evaluateBasis(direction);
    return [0, 1, 2].map((channel) =>
      this.coefficients.reduce((sum, rgb, term) => sum + weights[term]! * rgb[channel]!, 0),
    ) as unknown as Vector;
  }

  /** Irradiance on a surface with this unit normal; pi for a radiance of 1 from all directions. */
  irradiance(normal: Vector): Vector {
    return this.map((value, term) => value * COSINE_LOBE[term]!).radiance(normal);
  }

  private map(change: (value: number, term: number, channel: number) => number): Harmonics {
    return new Harmonics(
      this.coefficients.map(
        (rgb, term) => rgb.map((value, channel) => change(value, term, channel)) as unknown as Vector,
      ),
    );
  }
}
