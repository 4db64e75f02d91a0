// The endpoints that only the page uses; sessions, light and composites go through our client (`roomlight`).

import {
  RoomLight,
  RoomLightError,
  type CameraView,
  type FilmRequest,
  type HistoryList,
  type ObjectInfo,
  type PairedPhone,
  type Pairing,
  type Recording,
  type RecordingList,
  type SessionList,
  type SessionScene,
} from "roomlight";
import { Http, readJson, type HttpRequest } from "roomlight/http";

const TOKEN_KEY = "roomlight-token";
// Time limits of requests: of those that only read, of others and of pictures, and of up to 128 MB.
const [SHORT_S, LONG_S, TRANSFER_S] = [30, 150, 600];

type ApiRequest = Partial<Omit<HttpRequest, "path">> & { readonly timeout_s?: number };

/** A picture or file of the server with what identifies it. */
export interface Fetched {
  blob: Blob;
  etag: string;
  frame: number;
}

/** The objects and the title that the server keeps with a session. */
export interface KeptScene extends Required<SessionScene> {
  readonly etag: string;
}

/** The server that delivered the page. Throws RoomLightError, with status 0 if the server cannot be reached. */
export class Api {
  readonly base = new URL("/", location.href);
  private tokenValue: string | null;

  private code: string | null;
  private readonly session: string | null = null;

  /** Take the token, or the code of a phone's link, from the address and remove it there. */
  constructor() {
    const given = new URLSearchParams(location.hash.slice(1));
    this.tokenValue = given.get("token");
    this.code = given.get("pair");
    if (this.tokenValue) {
      keepToken("sessionStorage", this.tokenValue);
    }
    if (this.tokenValue || this.code) {
      given.delete("token");
      given.delete("pair");
      history.replaceState(null, "", `${location.pathname}${location.search}${given.size > 0 ? `#${given}` : ""}`);
    }
    this.tokenValue ??= keptToken("sessionStorage") ?? keptToken("localStorage");
    if (this.tokenValue !== null && !isToken(this.tokenValue)) {
      this.tokenValue = null; // no header can have it
    }
  }

  /** Get a token for this phone with the code of the address; false without one. The browser keeps the token. */
  async pair(): Promise<boolean> {
    if (this.code === null) {
      return false;
    }
    const body = jsonBody({ code: this.code });
    this.code = null; // it works once
    try {
      const { token } = await this.json<{ token: string }>("v1/phones", { method: "POST", ...body });
      keepToken("localStorage", token);
      this.token = token;
    } catch (error) {
      if (!this.tokenValue) {
        throw error; // a phone that has a token has used the code itself before
      }
    }
    return true;
  }

  get hasToken(): boolean {
    return this.tokenValue !== null;
  }

  set token(token: string) {
    this.tokenValue = token;
    keepToken("sessionStorage", token);
  }

  /** Our client for this server. */
  client(retries = 1): RoomLight {
    // longer than the server's own limits, whose answers say more: the first composite of a server compiles its kernels
    return new RoomLight(this.base, { retries, timeout_s: LONG_S, ...(this.tokenValue ? { token: this.tokenValue } : {}) });
  }

  /** The same, for what belongs to a session without being in its path: by the header a proxy finds the session's server. */
  of(session: string | null): Api {
    return Object.create(this, { session: { value: session } }) as Api;
  }

  async uploadGlb(file: Blob): Promise<ObjectInfo> {
    return this.client().upload(new Uint8Array(await file.arrayBuffer()), { kind: "glb", sessionId: this.session ?? undefined });
  }

  sessions(): Promise<SessionList> {
    return this.json("v1/sessions");
  }

  deleteSession(id: string): Promise<Response> {
    return this.send(sessionPath(id), { method: "DELETE" });
  }

  async scene(id: string): Promise<KeptScene> {
    const response = await this.send(`${sessionPath(id)}/scene`, {});
    return { ...(await readJson<Required<SessionScene>>(response)), etag: etagOf(response) };
  }

  /** Replace the scene with this ETag, or any; returns the new one. Throws RoomLightError `scene-changed` if it is another. */
  async keepScene(id: string, { title, objects }: SessionScene, etag = "*"): Promise<string> {
    const { body, headers } = jsonBody({ title, objects });
    return etagOf(await this.send(`${sessionPath(id)}/scene`, { method: "PUT", body, headers: { ...headers, "if-match": etag } }));
  }

  camera(id: string): Promise<CameraView> {
    return this.json(`${sessionPath(id)}/camera`);
  }

  history(id: string, after: number): Promise<HistoryList> {
    return this.json(`${sessionPath(id)}/history?after=${after}`);
  }

  pairing(): Promise<Pairing> {
    return this.json("v1/pairing", { method: "POST" });
  }

  async phones(): Promise<readonly PairedPhone[]> {
    return (await this.json<{ phones: PairedPhone[] }>("v1/phones")).phones;
  }

  removePhone(id: string): Promise<Response> {
    return this.send(`v1/phones/${id}`, { method: "DELETE" });
  }

  createRecording(name: string, bytes: number, files: number): Promise<Recording> {
    return this.json("v1/recordings", { method: "POST", ...jsonBody({ name, bytes, files }) });
  }

  /** The recording that is part of RoomLight, uploaded already. */
  addSample(): Promise<Recording> {
    return this.json("v1/sample-recording", { method: "POST" });
  }

  recording(id: string): Promise<Recording> {
    return this.json(`v1/recordings/${id}`);
  }

  recordings(): Promise<RecordingList> {
    return this.json("v1/recordings");
  }

  makeFilm(id: string, film: FilmRequest): Promise<Recording> {
    return this.json(`v1/recordings/${id}/film`, { method: "PUT", ...jsonBody(film) });
  }

  deleteFilm(id: string): Promise<Recording> {
    return this.json(`v1/recordings/${id}/film`, { method: "DELETE" });
  }

  deleteRecording(id: string): Promise<Response> {
    return this.send(`v1/recordings/${id}`, { method: "DELETE" });
  }

  replay(id: string, session: string): Promise<Recording> {
    return this.json(`v1/recordings/${id}/replay`, { method: "PUT", ...jsonBody({ session }) });
  }

  /** Send one piece of a file of a recording. */
  async putPiece(id: string, path: string, offset: number, piece: Blob, request: ApiRequest): Promise<Recording> {
    const encoded = path.split("/").map(encodeURIComponent).join("/");
    const headers = { "upload-offset": String(offset), "content-type": "application/octet-stream" };
    const body = new Uint8Array(await piece.arrayBuffer());
    return this.json(`v1/recordings/${id}/files/${encoded}`, { ...request, method: "PUT", body, headers, timeout_s: TRANSFER_S });
  }

  /** A file of the server; null if it still has this ETag. */
  async file(path: string, etag = ""): Promise<Fetched | null> {
    const timeout_s = path.endsWith("/film") ? TRANSFER_S : LONG_S;
    const response = await this.send(path, { headers: etag ? { "if-none-match": etag } : {}, timeout_s });
    if (response.status === 304) {
      return null;
    }
    return {
      blob: await response.blob(),
      etag: etagOf(response),
      frame: Number(response.headers.get("roomlight-frame") ?? -1),
    };
  }

  private async json<T>(path: string, request: ApiRequest = {}): Promise<T> {
    return readJson<T>(await this.send(path, request));
  }

  private async send(path: string, { timeout_s, ...request }: ApiRequest): Promise<Response> {
    // `no-store`: the page compares ETags itself, and a 304 must reach it. History pictures never change.
    const cache = path.includes("/history/") ? "default" : "no-store";
    const http = new Http(this.base, {
      retries: 0,
      timeout_s: timeout_s ?? (request.method ? LONG_S : SHORT_S),
      fetch: (url, init) => fetch(url, { cache, ...init }),
      ...(this.tokenValue ? { token: this.tokenValue } : {}),
    });
    const headers = { ...request.headers, ...(this.session !== null && { "x-session-id": this.session }) };
    return http.send({ method: "GET", path, ...request, headers });
  }
}

/** The token that the browser keeps; null without one, and where the visitor blocks what sites keep. */
function keptToken(storage: "sessionStorage" | "localStorage"): string | null {
  try {
    return globalThis[storage].getItem(TOKEN_KEY);
  } catch {
    return null; // reading the property throws already
  }
}

function keepToken(storage: "sessionStorage" | "localStorage", token: string): void {
  try {
    globalThis[storage].setItem(TOKEN_KEY, token);
  } catch {
    // this page has it until it is closed
  }
}

/** Whether a text can be a token in a header. */
export function isToken(text: string): boolean {
  return /^[\x21-\x7e]+$/.test(text);
}

/** Whether there was no answer, or that of a proxy whose server is away. */
export function isAway({ status, kind }: RoomLightError): boolean {
  return status === 0 || (kind === "" && [502, 503, 504].includes(status));
}

/** Whether an error says that a session is missing or has ended. */
export function isGone({ kind, message }: RoomLightError): boolean {
  return /session-(not-found|closed)/.test(`${kind} ${message}`);
}

export function sessionPath(id: string): string {
  return `v1/sessions/${encodeURIComponent(id)}`;
}

function etagOf(response: Response): string {
  return response.headers.get("etag") ?? "";
}

function jsonBody(value: object): { body: string; headers: Record<string, string> } {
  return { body: JSON.stringify(value), headers: { "content-type": "application/json" } };
}
