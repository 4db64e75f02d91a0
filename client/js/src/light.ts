// Light as it comes: JSON with base64, or "RLL1", the length of the JSON (u32, little-endian), the JSON, the parts.

import { LIGHT_MAGIC, type LightFormat, type EncodedLight, type LightResponse, type ProbeLight } from "./wire.js";

/** One form of a probe's light: `values` for sh and main_light, `data` for the others. */
export interface LightData extends Omit<EncodedLight, "data" | "bytes"> {
  data?: Uint8Array<ArrayBuffer>;
}

/** The light at one point. */
export interface Light extends Omit<ProbeLight, "forms"> {
  forms: readonly LightData[];
}

/** Light after `frame`, in the order in which it was asked for; `frame` -1: no frame is in it, it is the prior. */
export interface Lights extends Omit<LightResponse, "results"> {
  results: readonly Light[];
}

/** The first form of this format, if the light has one. */
export function formOf(light: Light, ...formats: readonly LightFormat[]): LightData | undefined {
  return light.forms.find((form) => formats.includes(form.format));
}

/** Lights from the JSON of an answer. */
export function decodeLights<T extends LightResponse>(response: T): Omit<T, "results"> & Lights {
  return withData(response, (form) => (form.data == null ? undefined : fromBase64(form.data)));
}

/** Lights from a binary message. RangeError if it is not a whole one. */
export function parseLights<T extends LightResponse>(body: ArrayBuffer): Omit<T, "results"> & Lights {
  const magic = new TextDecoder().decode(body.slice(0, 4));
  if (body.byteLength < 8 || magic !== LIGHT_MAGIC) {
    throw new RangeError(`a light message of ${body.byteLength} bytes that does not begin with ${LIGHT_MAGIC}`);
  }
  const start = 8 + new DataView(body).getUint32(4, true);
  if (start > body.byteLength) {
    throw new RangeError(`a light message whose JSON is cut off: ${body.byteLength} bytes of ${start}`);
  }
  const response = JSON.parse(new TextDecoder().decode(body.slice(8, start))) as T;
  let at = start;
  const lights = withData(response, (form) => {
    if (form.bytes == null) {
      return undefined;
    }
    at += form.bytes;
    return new Uint8Array(body.slice(at - form.bytes, at)); // copied: aligned for Float32Array, and free of the rest
  });
  if (at !== body.byteLength) {
    throw new RangeError(`a light message of ${body.byteLength} bytes that states ${at}`);
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
