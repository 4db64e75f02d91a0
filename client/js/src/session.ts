// Sessions over HTTP: send frames, get light, track points.

import { packFrame, type Frame } from "./frame.js";
import { Http, readJson, TIMEOUT_S, toJson, type ClientOptions, type HttpRequest } from "./http.js";
import { decodeLights, parseLights, type Light, type LightData, type Lights } from "./light.js";
import { SessionMemory } from "./memory.js";
import { SessionRequests } from "./session_link.js";
import { Stream, type SessionLink, type StreamOptions } from "./stream.js";
import { waiting } from "./waiting.js";
import {
  LIGHT_MEDIA_TYPE,
  type CompositeRequest,
  type FrameResult,
  type LightForm,
  type LightRequest,
  type LightResponse,
  type ObjectInfo,
  type ObjectList,
  type Position,
  type PositionLike,
  type SessionRequest,
  type SessionState,
} from "./wire.js";

/** Options of a session. */
export type SessionOptions = SessionRequest;

/** One form of the light at a point, as a file or as values. */
export interface LightFile {
  form: LightData;
  /** Identifies the light: pass it to the next request for the same point and form. */
  etag: string;
  /** Fraction of the sphere that was observed, 0 to 1. */
  coverage: number;
  /** Index of the last processed frame; -1 before the first one. */
  frame: number;
}

export interface CallOptions {
  signal?: AbortSignal | undefined;
}

/** Options of calls that concern objects. */
export interface ObjectOptions extends CallOptions {
  /** The session that uses them; needed where a proxy shares sessions among servers. */
  sessionId?: string | undefined;
}

/** A frame with objects in it. */
export interface CompositeFile {
  /** The picture; with the format "layers" a zip of the layers. */
  data: Blob;
  /** Index of the frame. */
  frame: number;
  /** Pose of each object by name, column by column: given as `pose` with the anchor "origin", it stays in place. */
  poses: { readonly [name: string]: readonly number[] };
  /** Share of each object by name that nothing real hides, 0 to 1. */
  visible: { readonly [name: string]: number };
}

/** A server. `new RoomLight("https://light.example").open()` */
export class RoomLight {
  private readonly http: Http;

  constructor(url: string | URL, options: ClientOptions = {}) {
    this.http = new Http(url, options);
  }

  /**
   * Open a session, or continue an existing one with the same id and options; the default id is random.
   *
   * Throws RoomLightError: with status 409 if the session exists with other options (`error.field` names the option).
   */
  async open(options: SessionOptions & { id?: string | undefined } & CallOptions = {}): Promise<Session> {
    const { id = randomId(), signal, ...request } = options;
    const response = await sendJson(this.http, { method: "PUT", path: pathOf(id), signal }, request);
    return new Session(this.http, id, await readJson<SessionState>(response), request);
  }

  /** Store an object (GLB, glTF, OBJ or PLY) for composites; its id is the SHA-256 of the file. */
  async upload(
    file: Uint8Array,
    options: ObjectOptions & { kind?: "glb" | "gltf" | "obj" | "ply" | undefined } = {},
  ): Promise<ObjectInfo> {
    const path = options.kind === undefined ? OBJECTS : `${OBJECTS}?kind=${options.kind}`;
    const { sessionId, signal } = options;
    const headers = { "content-type": "application/octet-stream", ...serverOf(sessionId) };
    const timeout_s = (this.http.options.timeout_s ?? TIMEOUT_S) + Math.floor(file.byteLength / SLOWEST_BYTES_PER_S);
    const request: HttpRequest = { method: "POST", path, body: file as Uint8Array<ArrayBuffer>, headers, signal, timeout_s };
    return readJson<ObjectInfo>(await this.http.send(request));
  }

  /** The objects of this token on the server, with their memory and its limit. */
  async objects({ sessionId, signal }: ObjectOptions = {}): Promise<ObjectList> {
    const response = await this.http.send({ method: "GET", path: OBJECTS, headers: serverOf(sessionId), signal });
    return await readJson<ObjectList>(response);
  }

  /** Delete an object on the server. A missing one is not an error. */
  async deleteObject(id: string, { sessionId, signal }: ObjectOptions = {}): Promise<void> {
    const path = `${OBJECTS}/${encodeURIComponent(id)}`;
    await this.http.send({ method: "DELETE", path, headers: serverOf(sessionId), signal });
  }

  /**
   * Continue an existing session, whatever its options.
   *
   * Throws RoomLightError: with status 404 if there is no such session.
   */
  async join(id: string, options: CallOptions = {}): Promise<Session> {
    const response = await this.http.send({ method: "GET", path: pathOf(id), signal: options.signal });
    return new Session(this.http, id, await readJson<SessionState>(response));
  }
}

/**
 * One room on a server, made by `RoomLight.open` or `RoomLight.join`. Its methods throw RoomLightError.
 *
 * A session made by `open` survives a server that was started again or let it expire: it is opened again with the same
 * options, its points are tracked, and its last frames are sent again.
 */
export class Session {
  /** Index of the next frame that has none of its own: one above all indices sent. */
  nextIndex: number;
  /** The model that estimates the light. */
  readonly model: SessionState["model"];
  private readonly path: string;
  private readonly memory: SessionMemory;
  private readonly requests: SessionRequests;
  private lastPacked: Promise<unknown> = Promise.resolve();

  constructor(
    private readonly http: Http,
    readonly id: string,
    state: SessionState,
    request: SessionRequest | null = null,
  ) {
    this.path = pathOf(id);
    this.model = state.model;
    this.nextIndex = (state.frames.last_index ?? -1) + 1;
    this.memory = new SessionMemory(request, http.options.buffer);
    this.requests = new SessionRequests(http, this.path, this.memory);
  }

  /**
   * Send a frame. Resolves when the frame is processed or dropped, or, with `wait: false`, when it is queued.
   *
   * Frames are sent in the order of the calls: one whose `data` is pending holds back the later ones until it is there
   * or its signal is aborted. They may be pushed before earlier ones are processed: the server processes the newest and
   * answers `superseded` for the others.
   */
  async push(frame: Frame, options: CallOptions & { wait?: boolean | undefined } = {}): Promise<FrameResult> {
    const { index, message } = this.pack(frame, options.signal);
    const headers: Record<string, string> = options.wait === false ? { prefer: "respond-async" } : {};
    return this.requests.push(index, await message, { headers, signal: options.signal });
  }

  /** Light at one point (a position or the name of a tracked point) in some forms. */
  async lightAt(point: PositionLike | string, forms: readonly LightForm[], options: CallOptions = {}): Promise<Light> {
    const probe = typeof point === "string" ? { name: point } : { position: point as Position };
    const { results } = await this.light({ probes: [probe], forms }, options);
    return results[0]!;
  }

  /** Light at several points, all after the same frame. */
  async light(request: LightRequest, options: CallOptions = {}): Promise<Lights> {
    const headers = { accept: `${LIGHT_MEDIA_TYPE}, application/json;q=0.9` };
    const http: HttpRequest = { method: "POST", path: `${this.path}/probes`, headers, signal: options.signal };
    const response = await sendJson(this.requests, http, request);
    if (response.headers.get("content-type")?.startsWith(LIGHT_MEDIA_TYPE)) {
      return parseLights<LightResponse>(await response.arrayBuffer());
    }
    return decodeLights(await readJson<LightResponse>(response));
  }

  /** One form of the light at a point. Null if the light still has the ETag `etag` of an earlier result. */
  async probe(
    point: PositionLike | string,
    form: LightForm,
    options: CallOptions & { etag?: string | undefined } = {},
  ): Promise<LightFile | null> {
    const query = new URLSearchParams();
    const position = typeof point === "string" ? {} : { x: point[0], y: point[1], z: point[2] };
    for (const [name, value] of Object.entries({ ...position, ...form })) {
      if (value != null) {
        query.set(name, String(value));
      }
    }
    const path = `${typeof point === "string" ? this.requests.probePath(point) : `${this.path}/probe`}?${query}`;
    const headers: Record<string, string> = options.etag ? { "if-none-match": options.etag } : {};
    const response = await this.requests.send({ method: "GET", path, headers, signal: options.signal });
    if (response.status === 304) {
      return null;
    }
    const header = (name: string) => response.headers.get(name) ?? "";
    const media_type = header("content-type");
    const content = media_type.startsWith("application/json")
      ? { values: await readJson<{ readonly [name: string]: unknown }>(response) }
      : { data: new Uint8Array(await response.arrayBuffer()) };
    return {
      form: { format: form.format, media_type, ...content },
      etag: header("etag"),
      coverage: Number(header("roomlight-coverage")),
      frame: Number(header("roomlight-frame")),
    };
  }

  /**
   * The last processed frame with objects in it: lit by the room, with shadows, behind real things in front.
   *
   * `timeout_s` is its time limit; by default the client's, but at least 130 s: servers take up to 120 s.
   */
  async composite(request: CompositeRequest, options: CallOptions & { timeout_s?: number | undefined } = {}): Promise<CompositeFile> {
    const { signal, timeout_s = Math.max(COMPOSITE_S, this.http.options.timeout_s ?? 0) } = options;
    const http: HttpRequest = { method: "POST", path: `${this.path}/composite`, signal, timeout_s };
    const response = await sendJson(this.requests, http, request);
    return {
      data: await response.blob(),
      frame: Number(response.headers.get("roomlight-frame")),
      poses: JSON.parse(response.headers.get("roomlight-poses") ?? "{}") as CompositeFile["poses"],
      visible: JSON.parse(response.headers.get("roomlight-visible") ?? "{}") as CompositeFile["visible"],
    };
  }

  /** Track a point under a name of 1 to 64 letters, digits, - and _; an existing name moves to the position. */
  async track(name: string, position: PositionLike, options: CallOptions = {}): Promise<void> {
    await this.requests.send({ ...this.requests.trackRequest(name, position), signal: options.signal });
    this.memory.track(name, position);
  }

  /** Stop tracking a point. An unknown name is not an error. */
  async untrack(name: string, options: CallOptions = {}): Promise<void> {
    await this.requests.send({ method: "DELETE", path: this.requests.probePath(name), signal: options.signal });
    this.memory.untrack(name);
  }

  /** Counts of frames, tracked points with their coverage, memory and the lighting volume. */
  async state(options: CallOptions = {}): Promise<SessionState> {
    const response = await this.requests.send({ method: "GET", path: this.path, signal: options.signal });
    return await readJson<SessionState>(response);
  }

  /** Delete the session and everything that the server stores for it. A missing one is not an error. */
  async delete(options: CallOptions = {}): Promise<void> {
    this.memory.deleted = true; // streams end with it
    await this.http.send({ method: "DELETE", path: this.path, signal: options.signal });
  }

  /**
   * Open the session's WebSocket. It shares the session's frame index, and connects again when the connection is lost.
   *
   * Throws RoomLightError: with status 404 if the session is missing.
   */
  stream(options: StreamOptions = {}): Promise<Stream> {
    const address = this.http.address(`${this.path}/stream`);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    const link: SessionLink = {
      address,
      client: this.http.options,
      memory: this.memory,
      pack: (frame) => this.pack(frame),
      resume: (reopen, signal) => this.requests.resume(reopen, signal),
    };
    return Stream.open(link, options);
  }

  /**
   * The message of a frame with its own index or the session's next one, which becomes one above it.
   *
   * Messages come in the order of the calls: a Blob takes longer to pack, but the server refuses an index below the last.
   */
  private pack(frame: Frame, signal?: AbortSignal): { index: number; message: Promise<Uint8Array<ArrayBuffer>> } {
    const index = frame.index ?? this.nextIndex;
    this.nextIndex = Math.max(this.nextIndex, index + 1);
    const packed = waiting.untilAborted(packFrame({ ...frame, index }), signal);
    packed.catch(() => undefined); // may fail before its turn comes
    const before = this.lastPacked;
    const message = waiting.untilAborted(before.then(() => packed), signal);
    this.lastPacked = Promise.allSettled([before, message]).then(() => undefined); // without the frames' bytes
    return { index, message };
  }
}

const OBJECTS = "v1/objects";
const COMPOSITE_S = 130;
const SLOWEST_BYTES_PER_S = 2 ** 14; // that a server accepts

function pathOf(id: string): string {
  return `v1/sessions/${encodeURIComponent(id)}`;
}

/** The header by which a proxy finds a session's server. */
function serverOf(sessionId: string | undefined): Record<string, string> {
  return sessionId === undefined ? {} : { "x-session-id": sessionId };
}

function sendJson(http: Http | SessionRequests, request: HttpRequest, json: object): Promise<Response> {
  return http.send({
    ...request,
    body: toJson(json),
    headers: { "content-type": "application/json", ...request.headers },
  });
}

/** 128 random bits. `crypto.randomUUID` is not available on pages without TLS; `getRandomValues` is. */
function randomId(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
