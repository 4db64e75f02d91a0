// Light messages: JSON with base64, or binary: "RLL1", length of the JSON (u32, little-endian), the JSON, the parts.

import {
  LIGHT_MAGIC,
  type EncodedLight,
  type LightFormat,
  type LightResponse,
  type LightUse,
  type ProbeLight,
} from "./wire.js";

/** One form of a probe's light: `values` for sh and main_light, `data` for the other formats. */
export interface LightData extends Omit<EncodedLight, "data" | "bytes"> {
  data?: Uint8Array<ArrayBuffer>;
}

/** The light at one point. */
export interface Light extends Omit<ProbeLight, "forms"> {
  forms: readonly LightData[];
}

/** Lights in the order of the request, after frame `frame`; -1 before the first frame: the default light. */
export interface Lights extends Omit<LightResponse, "results"> {
  results: readonly Light[];
}

/** The light's first form with one of these formats, of any use. */
export function findForm(light: Light, ...formats: readonly LightFormat[]): LightData | undefined {
  return light.forms.find((form) => formats.includes(form.format));
}

/** The light's first form with one of these formats that is for a use: it lights things, or is seen in a mirror. */
export function findFormFor(use: LightUse, light: Light, ...formats: readonly LightFormat[]): LightData | undefined {
  return light.forms.find((form) => formats.includes(form.format) && useOf(form) === use);
}

/** What a form is for: as it was requested, else `reflection` for a PNG and `lighting` for all others. */
export function useOf(form: Pick<LightData, "format" | "use">): LightUse {
  return form.use ?? (form.format === "png" ? "reflection" : "lighting");
}

/** Lights of a JSON message. */
export function decodeLights<T extends LightResponse>(response: T): Omit<T, "results"> & Lights {
  return withData(response, (form) => (form.data == null ? undefined : fromBase64(form.data)));
}

/** Lights of a binary message. Throws RangeError if it is malformed or truncated. */
export function parseLights<T extends LightResponse>(body: ArrayBuffer): Omit<T, "results"> & Lights {
  const magic = new TextDecoder().decode(body.slice(0, 4));
  if (body.byteLength < 8 || magic !== LIGHT_MAGIC) {
    throw new RangeError(`a light message must begin with ${LIGHT_MAGIC}, got ${body.byteLength} bytes that do not`);
  }
  const start = 8 + new DataView(body).getUint32(4, true);
  if (start > body.byteLength) {
    throw new RangeError(`the JSON of a light message is truncated: ${body.byteLength} of ${start} bytes`);
  }
  const response = JSON.parse(new TextDecoder().decode(body.slice(8, start))) as T;
  let offset = start;
  const lights = withData(response, (form) => {
    if (form.bytes == null) {
      return undefined;
    }
    offset += form.bytes;
    return new Uint8Array(body.slice(offset - form.bytes, offset)); // a copy, aligned for Float32Array
  });
  if (offset !== body.byteLength) {
    throw new RangeError(`a light message states ${offset} bytes, got ${body.byteLength}`);
  }
  return lights;
}

function withData<T extends LightResponse>(
  response: T,
  dataOf: (form: EncodedLight) => Uint8Array<ArrayBuffer> | undefined,
): Omit<T, "results"> & Lights {
  const results = response.results.map((result) => ({
    ...result,
    forms: result.forms.map((form) => {
      const { data: _base64, bytes: _length, ...rest } = form;
      const data = dataOf(form);
      return data === undefined ? rest : { ...rest, data };
    }),
  }));
  return { ...response, results };
}

function fromBase64(text: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}
