// L2 spherical harmonics of radiance, in the signs of three.js: Y00 Y1-1 Y10 Y11 Y2-2 Y2-1 Y20 Y21 Y22 over y, z, x, xy,
// yz, 3z2-1, xz, x2-y2, all of them positive. ARCore, WebXR and ARKit count with the Condon-Shortley phase: their terms
// of odd m (y, x, yz, xz) are negative.

import type { LightData } from "./light.js";

export type Vector = readonly [number, number, number];

/** The values of a form `sh`, as the server writes them. */
export interface HarmonicsValues {
  coefficients: readonly number[];
  layout: "interleaved" | "planar";
  phase: "condon-shortley" | "positive";
  quantity: "radiance" | "irradiance";
  kind: "total" | "ambient";
}

/** The values of a form `main_light`: unit direction toward the light; what it sheds on a surface that faces it. */
export interface MainLightValues {
  direction: Vector;
  intensity: Vector;
}

const ODD: readonly number[] = [1, 3, 5, 7]; // m = -1, 1, -1, 1
const BAND = [Math.PI, ...Array<number>(3).fill((2 * Math.PI) / 3), ...Array<number>(5).fill(Math.PI / 4)];

/** The nine basis functions at a unit direction. */
function basis([x, y, z]: Vector): number[] {
  const [c0, c1, c2] = [Math.sqrt(1 / (4 * Math.PI)), Math.sqrt(3 / (4 * Math.PI)), Math.sqrt(15 / (4 * Math.PI))];
  const [c3, c4] = [Math.sqrt(5 / (16 * Math.PI)), Math.sqrt(15 / (16 * Math.PI))];
  return [c0, c1 * y, c1 * z, c1 * x, c2 * x * y, c2 * y * z, c3 * (3 * z * z - 1), c2 * x * z, c4 * (x * x - y * y)];
}

/** Nine RGB coefficients. */
export class Harmonics {
  constructor(readonly coefficients: readonly Vector[]) {}

  /** From a form `sh` in any basis. RangeError if that is not what it is. */
  static of(form: LightData): Harmonics {
    const { coefficients, layout, phase, quantity } = (form.values ?? {}) as Partial<HarmonicsValues>;
    if (form.format !== "sh" || coefficients?.length !== 27 || !layout || !phase || quantity !== "radiance") {
      throw new RangeError(`27 coefficients of radiance, their layout and phase are wanted, got a form ${form.format}`);
    }
    const at = (term: number, channel: number) =>
      coefficients[layout === "planar" ? channel * 9 + term : term * 3 + channel]!;
    const sign = (term: number) => (phase === "condon-shortley" && ODD.includes(term) ? -1 : 1);
    return new Harmonics(
      Array.from(
        { length: 9 },
        (_, term) => [0, 1, 2].map((channel) => sign(term) * at(term, channel)) as unknown as Vector,
      ),
    );
  }

  /** What a directional light leaves: these, less intensity x basis(direction). Exact, as the server's `kind=ambient`. */
  without(direction: Vector, intensity: Vector): Harmonics {
    const delta = basis(direction);
    return this.map((value, term, channel) => value - delta[term]! * intensity[channel]!);
  }

  /** Radiance along a unit direction; nine harmonics ring, so it may dip below 0 beside a lamp. */
  radiance(direction: Vector): Vector {
    const at = basis(direction);
    return [0, 1, 2].map((channel) =>
      this.coefficients.reduce((sum, rgb, term) => sum + at[term]! * rgb[channel]!, 0),
    ) as unknown as Vector;
  }

  /** Irradiance on a surface with this unit normal: pi under light of 1 from everywhere. */
  irradiance(normal: Vector): Vector {
    return this.map((value, term) => value * BAND[term]!).radiance(normal);
  }

  private map(change: (value: number, term: number, channel: number) => number): Harmonics {
    return new Harmonics(
      this.coefficients.map(
        (rgb, term) => rgb.map((value, channel) => change(value, term, channel)) as unknown as Vector,
      ),
    );
  }
}
