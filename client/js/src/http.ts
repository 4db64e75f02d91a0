// Requests that are safe to send again, which all of the interface's are, with Retry-After, a time limit and AbortSignal.

import { RoomLightError } from "./errors.js";
import type { Problem } from "./wire.js";

/** How a client reaches its server; every field may be left out. */
export interface ClientOptions {
  /** Sent as a bearer token; sessions belong to the token that made them. */
  token?: string;
  /** How often a request is sent again after 429, 502, 503, 504 or a lost connection: 3 times. */
  retries?: number;
  /** For each try, 30 s. */
  timeout_s?: number;
  /** A longer Retry-After than this, 10 s, is an error at once: a phone's frame is worth nothing by then. */
  longestWait_s?: number;
  fetch?: typeof fetch;
  WebSocket?: typeof WebSocket;
}

export interface Call {
  method: "GET" | "PUT" | "POST" | "DELETE";
  path: string;
  body?: Uint8Array<ArrayBuffer> | string;
  headers?: Record<string, string>;
  signal?: AbortSignal | undefined;
}

const AGAIN: ReadonlySet<number> = new Set([429, 502, 503, 504]);
const FIRST_WAIT_S = 0.25; // doubled at each try, and jittered so that phones do not come back in step

/** One server. */
export class Http {
  readonly base: URL;
  private readonly fetch: typeof fetch;

  constructor(
    url: string | URL,
    readonly options: ClientOptions,
  ) {
    this.base = new URL(url);
    if (!this.base.pathname.endsWith("/")) {
      this.base.pathname += "/";
    }
    this.fetch = options.fetch ?? globalThis.fetch.bind(globalThis);
  }

  /** The address of a path under the server's own. */
  address(path: string): URL {
    return new URL(path, this.base);
  }

  /** The answer, of status 200 to 399. RoomLightError else; the signal's reason once it is aborted. */
  async send(call: Call): Promise<Response> {
    const { retries = 3, longestWait_s = 10 } = this.options;
    for (let attempt = 0; ; attempt++) {
      const failure = await this.attempt(call);
      if (failure instanceof Response) {
        return failure;
      }
      const [error, after_s] = failure;
      if (call.method === "DELETE" && error.status === 404 && attempt > 0) {
        return new Response(null, { status: 204 }); // an earlier try did it, its answer was lost
      }
      const wait_s = after_s ?? FIRST_WAIT_S * 2 ** attempt * (0.5 + Math.random());
      if (attempt >= retries || !(error.status === 0 || AGAIN.has(error.status)) || wait_s > longestWait_s) {
        throw error;
      }
      await pause(wait_s, call.signal);
    }
  }

  /** An answer, or the error and the seconds that the server asks to wait. */
  private async attempt(call: Call): Promise<Response | [RoomLightError, number | null]> {
    call.signal?.throwIfAborted();
    const { token, timeout_s = 30 } = this.options;
    const { method, path, body = null, signal } = call;
    const headers = { ...call.headers, ...(token ? { authorization: `Bearer ${token}` } : {}) };
    const limit = new AbortController();
    const abort = () => limit.abort(signal?.reason);
    const late = new RoomLightError(`${method} ${path}: no answer in ${timeout_s} s`, 0);
    const timer = setTimeout(() => limit.abort(late), timeout_s * 1000);
    signal?.addEventListener("abort", abort, { once: true });
    try {
      const answer = await this.fetch(this.address(path), { method, body, headers, signal: limit.signal });
      if (answer.ok || answer.status === 304) {
        // The body is read under the same limit: a stalled one must not outlive it.
        const read = answer.status === 304 || answer.status === 204 ? null : await answer.arrayBuffer();
        return new Response(read, { status: answer.status, headers: answer.headers });
      }
      return [await refusal(answer, `${method} ${path}`), retryAfter_s(answer)];
    } catch (cause) {
      signal?.throwIfAborted();
      if (cause === late) {
        return [late, null];
      }
      return [new RoomLightError(`${method} ${this.address(path)}: no connection`, 0, null, { cause }), null];
    } finally {
      clearTimeout(timer);
      signal?.removeEventListener("abort", abort);
    }
  }
}

async function refusal(answer: Response, what: string): Promise<RoomLightError> {
  const text = await answer.text();
  if (answer.headers.get("content-type")?.includes("json")) {
    try {
      return RoomLightError.of({
        title: what,
        detail: text.slice(0, 200),
        ...JSON.parse(text),
        status: answer.status,
      } as Problem);
    } catch {
      // a proxy's page that calls itself JSON: told like any other
    }
  }
  return new RoomLightError(`${what}: ${answer.status} ${text.slice(0, 200)}`, answer.status);
}

/** Seconds, or a date (RFC 9110). */
function retryAfter_s(answer: Response): number | null {
  const header = answer.headers.get("retry-after");
  if (header === null) {
    return null;
  }
  const wait_s = /^\s*\d+(\.\d+)?\s*$/.test(header) ? Number(header) : (Date.parse(header) - Date.now()) / 1000;
  return Number.isNaN(wait_s) ? null : Math.max(wait_s, 0);
}

function pause(seconds: number, signal: AbortSignal | undefined): Promise<void> {
  return new Promise((resolve, reject) => {
    signal?.throwIfAborted();
    const stop = () => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, seconds * 1000);
    signal?.addEventListener("abort", stop, { once: true });
  });
}
