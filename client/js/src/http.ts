// HTTP requests with retries, Retry-After, a time limit and AbortSignal. All requests of the interface are idempotent.

import { RoomLightError } from "./errors.js";
import type { BufferOptions } from "./memory.js";
import type { ReconnectOptions } from "./reconnect.js";
import { waiting } from "./waiting.js";
import type { Problem } from "./wire.js";

/** How a client connects to its server. */
export interface ClientOptions {
  /** Sent as a bearer token. A session belongs to the token that opened it. */
  token?: string | undefined;
  /** Retries after 408, 429, 502, 503, 504 and lost connections; default 3. `composite` and `upload` do not repeat after 408 and 504. */
  retries?: number | undefined;
  /** Time limit of each attempt; default 30 s. `composite` has its own, `upload` more for large files; neither is repeated after it. */
  timeout_s?: number | undefined;
  /** Longest Retry-After to wait for; default 10 s. After a longer one the request fails at once. */
  maxRetryAfter_s?: number | undefined;
  /** When streams and `push` connect again after the server was lost; false: never. */
  reconnect?: ReconnectOptions | false | undefined;
  /** Bounds of the frames that are kept to be sent again. */
  buffer?: BufferOptions | undefined;
  /** Replaces the global `fetch`. */
  fetch?: typeof fetch | undefined;
  /** Replaces the global `WebSocket`. */
  WebSocket?: typeof WebSocket | undefined;
}

export interface HttpRequest {
  method: "GET" | "PUT" | "POST" | "DELETE";
  path: string;
  body?: Uint8Array<ArrayBuffer> | string;
  headers?: Record<string, string>;
  signal?: AbortSignal | undefined;
  /** Replaces the client's `timeout_s`. */
  timeout_s?: number | undefined;
  /** Replaces the client's `retries`. */
  retries?: number | undefined;
  /** Called before each further attempt, with the reason for it. What it throws ends the attempts. */
  beforeRetry?: (error: RoomLightError) => Promise<void>;
}

const RETRIED: ReadonlySet<number> = new Set([408, 429, 502, 503, 504]);
export const TIMEOUT_S = 30;
const FIRST_DELAY_S = 0.25; // doubled after each attempt, with jitter so that phones do not retry together

/** The connection to one server. */
export class Http {
  readonly base: URL;
  readonly options: ClientOptions;
  private readonly fetch: typeof fetch;

  constructor(
    url: string | URL,
    options: ClientOptions,
  ) {
    const token = options.token?.trim() ?? "";
    const [bad] = /[^\x21-\x7e]/u.exec(token) ?? [];
    if (bad !== undefined) {
      throw new RoomLightError(`the token must be ASCII without spaces, as a header has it; got one with ${JSON.stringify(bad)}`, 0);
    }
    this.options = { ...options, token };
    this.base = serverAddress(url);
    if (!this.base.pathname.endsWith("/")) {
      this.base.pathname += "/";
    }
    this.fetch = options.fetch ?? globalThis.fetch.bind(globalThis);
  }

  /** The address of a path below the server's own. */
  address(path: string): URL {
    return new URL(path, this.base);
  }

  /** Send a request. Throws RoomLightError for a status of 400 and above, the signal's reason once it is aborted. */
  async send(request: HttpRequest): Promise<Response> {
    const { maxRetryAfter_s = 10 } = this.options;
    const retries = request.retries ?? this.options.retries ?? 3;
    for (let attempt = 0; ; attempt++) {
      const outcome = await this.attempt(request);
      if (outcome instanceof Response) {
        return outcome;
      }
      const [error, retryAfter_s, isTimeout = false] = outcome;
      if (request.method === "DELETE" && (error.status === 404 || error.status === 410)) {
        return new Response(null, { status: 204 }); // it is gone: the response to an earlier attempt may be lost
      }
      const delay_s = retryAfter_s ?? FIRST_DELAY_S * 2 ** attempt * (0.5 + waiting.random());
      // the server would do it twice, or the body be sent twice
      const isLong = request.method === "POST" && !request.path.endsWith("/probes");
      const isWorkedOn = isLong && (isTimeout || error.status === 408 || error.status === 504);
      const isTemporary = !isWorkedOn && (error.status === 0 || RETRIED.has(error.status));
      if (attempt >= retries || !isTemporary || delay_s > maxRetryAfter_s) {
        throw error;
      }
      await waiting.delay(delay_s, request.signal);
      await request.beforeRetry?.(error);
    }
  }

  /** The response, or the error, the server's Retry-After in seconds, and whether the time limit was the reason. */
  private async attempt(request: HttpRequest): Promise<Response | [RoomLightError, number | null, boolean?]> {
    request.signal?.throwIfAborted();
    const { token } = this.options;
    const { method, path, body = null, signal, timeout_s = this.options.timeout_s ?? TIMEOUT_S } = request;
    const headers = { ...request.headers, ...(token ? { authorization: `Bearer ${token}` } : {}) };
    const limit = new AbortController();
    const abort = () => limit.abort(signal?.reason);
    const timeout = new RoomLightError(`${method} ${path}: no answer in ${timeout_s} s`, 0);
    const timer = setTimeout(() => limit.abort(timeout), timeout_s * 1000);
    signal?.addEventListener("abort", abort, { once: true });
    try {
      const response = await this.fetch(this.address(path), { method, body, headers, signal: limit.signal });
      if (response.ok || response.status === 304) {
        // Read the body under the same limit, because a stalled body must time out as well.
        const read = response.status === 304 || response.status === 204 ? null : await response.arrayBuffer();
        return new Response(read, { status: response.status, headers: response.headers });
      }
      return [await errorOf(response, `${method} ${path}`), parseRetryAfter_s(response)];
    } catch (cause) {
      signal?.throwIfAborted();
      if (cause === timeout) {
        return [timeout, null, true];
      }
      const reason = `no connection (${reasonOf(cause)})`;
      return [new RoomLightError(`${method} ${this.address(path)}: ${reason}`, 0, null, { cause }), null];
    } finally {
      clearTimeout(timer);
      signal?.removeEventListener("abort", abort);
    }
  }
}

/** A value as JSON; typed arrays become arrays. */
export function toJson(value: object): string {
  return JSON.stringify(value, (_, part: unknown) => (ArrayBuffer.isView(part) ? Array.from(part as Float32Array) : part));
}

/** The JSON of a response. Throws RoomLightError with status 0 if it has none: it is of another server, such as a sign-in page. */
export async function readJson<T>(response: Response): Promise<T> {
  const text = await response.text();
  try {
    return JSON.parse(text) as T;
  } catch (cause) {
    const start = JSON.stringify(text.slice(0, 80));
    throw new RoomLightError(`an answer with status ${response.status} is not JSON, so not of a RoomLight server: ${start}`, 0, null, { cause });
  }
}

/** Why there is no connection; Node has it in the cause of the error that it throws, without a text for several addresses. */
function reasonOf(error: unknown): string {
  const cause = (error as { cause?: { message?: string; code?: string } } | null)?.cause;
  return cause?.message || cause?.code || (error instanceof Error ? error.message : String(error));
}

async function errorOf(response: Response, request: string): Promise<RoomLightError> {
  const text = await response.text();
  if (response.headers.get("content-type")?.includes("json")) {
    try {
      return RoomLightError.fromProblem({
        title: request,
        detail: text.slice(0, 200),
        ...JSON.parse(text),
        status: response.status,
      } as Problem);
    } catch {
      // a proxy's page with a wrong content type: reported as plain text
    }
  }
  return new RoomLightError(`${request}: ${response.status} ${text.slice(0, 200)}`, response.status);
}

/** The seconds of a Retry-After header, which is a number or a date (RFC 9110). */
function parseRetryAfter_s(response: Response): number | null {
  const header = response.headers.get("retry-after");
  if (header === null) {
    return null;
  }
  const delay_s = /^\s*\d+(\.\d+)?\s*$/.test(header) ? Number(header) : (Date.parse(header) - Date.now()) / 1000;
  return Number.isNaN(delay_s) ? null : Math.max(delay_s, 0);
}

/** The address of a server. Throws RoomLightError for one that no request can be sent to. */
function serverAddress(url: string | URL): URL {
  try {
    const address = new URL(url);
    if (/^https?:$/.test(address.protocol) && !address.username && !address.password) {
      return address;
    }
  } catch {
    // no address at all
  }
  throw new RoomLightError(`the server must be an address such as https://light.example, without a user; got ${url}`, 0);
}
