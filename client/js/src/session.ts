// A session over HTTP: frames in, light out, points that are followed.

import { packFrame, type Frame } from "./frame.js";
import { Http, type Call, type ClientOptions } from "./http.js";
import { decodeLights, parseLights, type Light, type LightData, type Lights } from "./light.js";
import { Stream, type StreamOptions } from "./stream.js";
import {
  LIGHT_MEDIA_TYPE,
  type LightForm,
  type FrameResult,
  type LightRequest,
  type LightResponse,
  type Position,
  type SessionRequest,
  type SessionState,
} from "./wire.js";

const FRAME_MEDIA_TYPE = "application/vnd.roomlight.frame";

/** One form of the light at a point, and what to name it by when asking again. */
export interface Probed {
  form: LightData;
  etag: string;
  coverage: number;
  frame: number;
}

export interface CallOptions {
  signal?: AbortSignal;
}

/** A server. `new RoomLight("https://light.example").open()` */
export class RoomLight {
  private readonly http: Http;

  constructor(url: string | URL, options: ClientOptions = {}) {
    this.http = new Http(url, options);
  }

  /** Open a session, or find the one of this id with these same options; its id is made here if none is given. */
  async open(options: SessionRequest & { id?: string } & CallOptions = {}): Promise<Session> {
    const { id = newId(), signal, ...request } = options;
    const session = new Session(this.http, id);
    await send(this.http, { method: "PUT", path: session.path, signal }, request);
    return session;
  }
}

export class Session {
  /** The index that the next frame without one of its own gets. */
  nextIndex = 0;
  readonly path: string;

  constructor(
    private readonly http: Http,
    readonly id: string,
  ) {
    this.path = `v1/sessions/${encodeURIComponent(id)}`;
  }

  /**
   * Send a frame; resolves when its fate is known, or, with `wait: false`, once it is queued.
   *
   * A frame may be pushed while earlier ones are on their way: the newest wins, and the others are `superseded`.
   */
  async push(frame: Frame, options: CallOptions & { wait?: boolean } = {}): Promise<FrameResult> {
    const numbered = number(frame, this);
    const call: Call = {
      method: "PUT",
      path: `${this.path}/frames/${numbered.index}`,
      body: await packFrame(numbered),
      headers: { "content-type": FRAME_MEDIA_TYPE, ...(options.wait === false ? { prefer: "respond-async" } : {}) },
      signal: options.signal,
    };
    return (await (await this.http.send(call)).json()) as FrameResult;
  }

  /** Light at one point, a position or the name of a followed one, in some forms. */
  async lightAt(point: Position | string, forms: readonly LightForm[], options: CallOptions = {}): Promise<Light> {
    const probe = typeof point === "string" ? { name: point } : { position: point };
    const { results } = await this.light({ probes: [probe], forms }, options);
    return results[0]!;
  }

  /** Light at several points, all at one moment of the session. */
  async light(request: LightRequest, options: CallOptions = {}): Promise<Lights> {
    const headers = { accept: `${LIGHT_MEDIA_TYPE}, application/json;q=0.9` };
    const call: Call = { method: "POST", path: `${this.path}/probes`, headers, signal: options.signal };
    const answer = await send(this.http, call, request);
    if (answer.headers.get("content-type")?.startsWith(LIGHT_MEDIA_TYPE)) {
      return parseLights<LightResponse>(await answer.arrayBuffer());
    }
    return decodeLights((await answer.json()) as LightResponse);
  }

  /** One form of the light at a point; null if the light that `etag`, of an earlier answer, names still stands there. */
  async probe(
    point: Position | string,
    form: LightForm,
    options: CallOptions & { etag?: string } = {},
  ): Promise<Probed | null> {
    const query = new URLSearchParams();
    const place = typeof point === "string" ? {} : { x: point[0], y: point[1], z: point[2] };
    for (const [name, value] of Object.entries({ ...place, ...form })) {
      if (value != null) {
        query.set(name, String(value));
      }
    }
    const path = `${typeof point === "string" ? this.probePath(point) : `${this.path}/probe`}?${query}`;
    const headers: Record<string, string> = options.etag ? { "if-none-match": options.etag } : {};
    const answer = await this.http.send({ method: "GET", path, headers, signal: options.signal });
    if (answer.status === 304) {
      return null;
    }
    const head = (name: string) => answer.headers.get(name) ?? "";
    const media_type = head("content-type");
    const content = media_type.startsWith("application/json")
      ? { values: (await answer.json()) as { readonly [name: string]: unknown } }
      : { data: new Uint8Array(await answer.arrayBuffer()) };
    return {
      form: { format: form.format, media_type, ...content },
      etag: head("etag"),
      coverage: Number(head("roomlight-coverage")),
      frame: Number(head("roomlight-frame")),
    };
  }

  /** Follow a point from frame to frame under a name; a name that is taken moves. */
  async track(name: string, position: Position, options: CallOptions = {}): Promise<void> {
    await send(this.http, { method: "PUT", path: this.probePath(name), signal: options.signal }, { position });
  }

  /** No longer follow it. */
  async untrack(name: string, options: CallOptions = {}): Promise<void> {
    await this.http.send({ method: "DELETE", path: this.probePath(name), signal: options.signal });
  }

  async state(options: CallOptions = {}): Promise<SessionState> {
    const answer = await this.http.send({ method: "GET", path: this.path, signal: options.signal });
    return (await answer.json()) as SessionState;
  }

  /** End the session, and free what the server holds for it. */
  async delete(options: CallOptions = {}): Promise<void> {
    await this.http.send({ method: "DELETE", path: this.path, signal: options.signal });
  }

  /** Open the session's WebSocket. Frames that it sends go on with this session's count. */
  stream(options: StreamOptions = {}): Promise<Stream> {
    const address = this.http.address(`${this.path}/stream`);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    return Stream.open(address, this.http.options, options, (frame) => number(frame, this));
  }

  private probePath(name: string): string {
    return `${this.path}/probes/${encodeURIComponent(name)}`;
  }
}

/** The frame with its index; the count goes on from it. */
function number(frame: Frame, session: Session): Frame & { index: number } {
  const index = frame.index ?? session.nextIndex;
  session.nextIndex = Math.max(session.nextIndex, index + 1);
  return { ...frame, index };
}

function send(http: Http, call: Call, json: object): Promise<Response> {
  return http.send({
    ...call,
    body: JSON.stringify(json),
    headers: { "content-type": "application/json", ...call.headers },
  });
}

/** 128 random bits; `crypto.randomUUID` is missing on pages without TLS, this is not. */
function newId(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
