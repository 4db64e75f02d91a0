// How long a client waits before it connects again, and which failures are worth another attempt.

import type { RoomLightError } from "./errors.js";
import { waiting } from "./waiting.js";

/** When a client connects again. Half of each delay is random, so that phones do not return all at once. */
export interface ReconnectOptions {
  /** Attempts in a row without success; default 60, which is about eight minutes. */
  attempts?: number | undefined;
  /** Delay before the first attempt; it doubles from one attempt to the next. Default 0.25 s. */
  firstDelay_s?: number | undefined;
  /** Longest delay; default 10 s. */
  maxDelay_s?: number | undefined;
}

/** The delays of one series of attempts. */
export class Backoff {
  private failed = 0;

  constructor(private readonly options: ReconnectOptions | false = {}) {}

  /** Attempts since the last success. */
  get attempt(): number {
    return this.failed;
  }

  /** Count a failure. The delay until the next attempt, or null if no attempt is left. */
  next(): number | null {
    const { attempts = 60, firstDelay_s = 0.25, maxDelay_s = 10 } = this.options || { attempts: 0 };
    this.failed++;
    if (this.failed > attempts) {
      return null;
    }
    return Math.min(maxDelay_s, firstDelay_s * 2 ** Math.min(this.failed - 1, 60)) * (0.5 + 0.5 * waiting.random());
  }

  /** Start again with the first delay. */
  reset(): void {
    this.failed = 0;
  }
}

/** Whether the same request may succeed later: no answer, a busy server, a proxy without its server. */
export function isTemporary({ status }: RoomLightError): boolean {
  return status === 0 || status === 408 || status === 429 || status >= 500;
}

/** No answer, or that of a proxy whose server is away, or of a server before. */
export function isServerLost({ status, kind }: RoomLightError): boolean {
  return status === 0 || status === 502 || status === 504 || (status === 503 && ["", "stopping", "session-moved"].includes(kind));
}

/** Whether the server no longer has the session: it expired, was deleted, or the server was started again. */
export function isSessionGone({ kind }: RoomLightError): boolean {
  return kind === "session-not-found" || kind === "session-closed";
}
