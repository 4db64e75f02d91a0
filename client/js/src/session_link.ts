// Requests of one session that survive a server which was started again: the session is opened once more with the same
// options, its points are tracked and the frames that it lost are sent again.

import { RoomLightError } from "./errors.js";
import { readJson, toJson, type Http, type HttpRequest } from "./http.js";
import { checkName, type SessionMemory } from "./memory.js";
import { Backoff, isServerLost, isSessionGone, isTemporary } from "./reconnect.js";
import { waiting } from "./waiting.js";
import { FRAME_MEDIA_TYPE, type FrameResult, type PositionLike, type SessionState } from "./wire.js";

export class SessionRequests {
  private recovering: Promise<void> | null = null;
  /** Whether the server may have been started again since its last answer. */
  private unsure = false;

  constructor(
    private readonly http: Http,
    private readonly path: string,
    private readonly memory: SessionMemory,
  ) {}

  /** Send a request of the session; a session that is missing is opened again, once. Waits while that is done. */
  async send(request: HttpRequest): Promise<Response> {
    if (this.recovering) {
      await this.recover(request.signal);
    }
    const beforeRetry = async (error: RoomLightError) => void (this.unsure ||= isServerLost(error));
    try {
      return await this.http.send({ ...request, beforeRetry });
    } catch (error) {
      if (!this.canReopenAfter(error)) {
        throw error;
      }
      await this.recover(request.signal);
      return this.http.send(request);
    }
  }

  /** Send a frame; until the server answers again, with the client's delays of `reconnect`. */
  async push(index: number, message: Uint8Array<ArrayBuffer>, request: Omit<HttpRequest, "method" | "path">) {
    const full: HttpRequest = { ...this.frameRequest(index, message), ...request };
    full.headers = { ...this.frameRequest(index, message).headers, ...request.headers };
    const { frames } = this.memory;
    frames.add(index, message, "sent");
    try {
      const result = await this.insist(full);
      frames.settle(result);
      return result;
    } catch (error) {
      frames.remove(index);
      throw error;
    }
  }

  /** The session's state, by one request; with `reopen` a missing session is opened again. */
  async resume(reopen: boolean, signal?: AbortSignal): Promise<{ state: SessionState; reopened: boolean }> {
    const request = { path: this.path, signal, ...(reopen ? { retries: 0 } : {}) };
    try {
      const response = await this.http.send({ ...request, method: "GET" });
      return { state: await readJson<SessionState>(response), reopened: false };
    } catch (error) {
      if (!reopen || !this.canReopenAfter(error)) {
        throw error;
      }
      if (isStateRefused(error)) {
        await this.http.send({ ...request, method: "DELETE" }); // the server keeps its damaged files until then
      }
      const headers = { "content-type": "application/json" };
      const body = JSON.stringify(this.memory.request);
      const response = await this.http.send({ ...request, method: "PUT", headers, body });
      return { state: await readJson<SessionState>(response), reopened: true };
    }
  }

  private async insist(request: HttpRequest): Promise<FrameResult> {
    const { reconnect } = this.http.options;
    const backoff = new Backoff(reconnect);
    const beforeRetry = async (error: RoomLightError) => {
      this.unsure ||= isServerLost(error);
      await this.recoverIfUnsure(request.signal);
    };
    let reopened = false;
    for (;;) {
      try {
        await this.recoverIfUnsure(request.signal);
        const response = await this.http.send(reconnect === false ? request : { ...request, beforeRetry });
        return await readJson<FrameResult>(response);
      } catch (error) {
        if (!(error instanceof RoomLightError) || reconnect === false) {
          throw error;
        }
        if (this.canReopenAfter(error) && !reopened) {
          this.unsure = reopened = true;
          continue;
        }
        this.unsure ||= isServerLost(error);
        const delay_s = isServerLost(error) ? backoff.next() : null;
        if (delay_s === null) {
          throw error;
        }
        await waiting.delay(delay_s, request.signal);
      }
    }
  }

  private async recoverIfUnsure(signal: AbortSignal | undefined): Promise<void> {
    if (this.unsure) {
      await this.recover(signal);
    }
  }

  /** Bring the session up to date, once for all calls that wait for it; a call that is aborted leaves it to the others. */
  private recover(signal: AbortSignal | undefined): Promise<void> {
    this.recovering ??= this.restore().finally(() => (this.recovering = null));
    return waiting.untilAborted(this.recovering, signal);
  }

  private async restore(): Promise<void> {
    this.unsure = true; // until all is done
    const { state } = await this.resume(this.memory.canReopen);
    const probes = this.memory.probesToRestore(state);
    for (const name of probes.untrack) {
      await this.http.send({ method: "DELETE", path: this.probePath(name) });
      this.memory.changed.delete(name);
    }
    for (const [name, position] of probes.track) {
      await this.restoreTrack(name, position);
      this.memory.changed.delete(name);
    }
    const last = state.frames.last_index ?? -1;
    for (const { index, message } of [...this.memory.frames].filter((one) => one.state === "done" && one.index > last)) {
      await this.resend(index, message);
    }
    this.unsure = false;
  }

  private async restoreTrack(name: string, position: PositionLike) {
    try {
      await this.http.send(this.trackRequest(name, position));
    } catch (error) {
      if (!(error instanceof RoomLightError) || isTemporary(error) || isSessionGone(error)) {
        throw error;
      }
      this.memory.probes.delete(name); // refused, as over the stream
    }
  }

  private async resend(index: number, message: Uint8Array<ArrayBuffer>) {
    try {
      const response = await this.http.send(this.frameRequest(index, message));
      this.memory.frames.settle(await readJson<FrameResult>(response));
    } catch (error) {
      if (!(error instanceof RoomLightError) || isServerLost(error) || isSessionGone(error)) {
        throw error;
      }
      this.memory.frames.remove(index); // refused, or already there
    }
  }

  trackRequest(name: string, position: PositionLike): HttpRequest {
    const headers = { "content-type": "application/json" };
    return { method: "PUT", path: this.probePath(name), headers, body: toJson({ position }) };
  }

  probePath(name: string): string {
    return `${this.path}/probes/${checkName(name)}`;
  }

  private frameRequest(index: number, message: Uint8Array<ArrayBuffer>): HttpRequest {
    const headers = { "content-type": FRAME_MEDIA_TYPE };
    return { method: "PUT", path: `${this.path}/frames/${index}`, body: message, headers };
  }

  private canReopenAfter(error: unknown): boolean {
    const gone = error instanceof RoomLightError && (isSessionGone(error) || isStateRefused(error));
    return gone && this.memory.canReopen && this.http.options.reconnect !== false;
  }
}

/** The server cannot use the state that it has saved. */
function isStateRefused(error: unknown): boolean {
  return error instanceof RoomLightError && error.kind === "state-refused";
}
