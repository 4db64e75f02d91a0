// What a client keeps of its session, to bring a server up to date that was started again: the options, the tracked
// points and the last frames.

import { RoomLightError } from "./errors.js";
import type { FrameResult, LightForm, Position, PositionLike, SessionRequest, SessionState } from "./wire.js";

/** Bounds of the frames that a client keeps. */
export interface BufferOptions {
  /** Number of frames; default 128. A server with a state directory writes them down within 5 s. */
  frames?: number | undefined;
  /** Bytes of their messages; default 64,000,000. The newest frame is kept whatever its size. */
  bytes?: number | undefined;
}

/**
 * A frame that may have to be sent again.
 *
 * waiting: to be sent. sent: on the way, without an answer. done: in the light of the server, unless it loses it.
 */
export interface KeptFrame {
  readonly index: number;
  readonly message: Uint8Array<ArrayBuffer>;
  state: "waiting" | "sent" | "done";
  /** How often it was sent. */
  sends: number;
}

/** The last frames of a session, in the order of their indices. */
export class FrameBuffer {
  private kept: KeptFrame[] = [];
  private forgottenTop = -1;

  constructor(private readonly options: BufferOptions = {}) {}

  /** Add a frame. Returns the frames that are dropped for it: first the oldest in the light, then the oldest. */
  add(index: number, message: Uint8Array<ArrayBuffer>, state: KeptFrame["state"] = "waiting"): KeptFrame[] {
    const { frames = 128, bytes = 64e6 } = this.options;
    const added: KeptFrame = { index, message, state, sends: state === "sent" ? 1 : 0 };
    const others = this.kept.filter((frame) => frame.index !== index);
    this.kept = [...others, added].sort((a, b) => a.index - b.index);
    const dropped: KeptFrame[] = [];
    while (this.kept.length > 1 && (this.kept.length > frames || this.bytes > bytes)) {
      const candidates = this.kept.filter((frame) => frame !== added);
      const frame = candidates.find(({ state }) => state === "done") ?? candidates[0]!;
      dropped.push(frame);
      this.forget(frame);
    }
    return dropped;
  }

  find(index: number): KeptFrame | undefined {
    return this.kept.find((frame) => frame.index === index);
  }

  remove(index: number): void {
    this.kept = this.kept.filter((frame) => frame.index !== index);
  }

  /** Record the result of a frame. Only frames in the light are kept, until the server has written them down. */
  settle(result: Pick<FrameResult, "index" | "status" | "durable_index">): void {
    const frame = this.find(result.index);
    if (frame && (result.status === "processed" || result.status === "queued")) {
      frame.state = "done";
    } else {
      this.remove(result.index);
    }
    const durable = result.durable_index ?? -1;
    this.kept.filter(({ index, state }) => state === "done" && index <= durable).forEach((one) => this.forget(one));
  }

  /** Whether a session that has the frames up to this index lacks some that are no longer kept. */
  lacks(lastIndex: number): boolean {
    return this.forgottenTop > lastIndex;
  }

  get bytes(): number {
    return this.kept.reduce((sum, { message }) => sum + message.length, 0);
  }

  [Symbol.iterator](): IterableIterator<KeptFrame> {
    return this.kept[Symbol.iterator]();
  }

  private forget({ index, state }: KeptFrame): void {
    this.remove(index);
    if (state !== "waiting") {
      this.forgottenTop = Math.max(this.forgottenTop, index);
    }
  }
}

/** The name of a point. Throws RoomLightError if the server has no such names. */
export function checkName(name: string): string {
  if (!/^[A-Za-z0-9_-]{1,64}$/.test(name)) {
    throw new RoomLightError(`the name of a point must be 1 to 64 letters, digits, - and _; got ${JSON.stringify(name)}`, 0);
  }
  return name;
}

/** The memory of one session. */
export class SessionMemory {
  readonly frames: FrameBuffer;
  readonly probes = new Map<string, Position>();
  /** Points that were tracked or removed over a stream, until the server says so. */
  readonly changed = new Set<string>();
  /** Forms of the stream's subscription. */
  forms: readonly LightForm[] = [];
  /** The app has deleted the session: it must not be opened again. */
  deleted = false;

  /** `request`: the options of a session that this client opened; null for one that it joined. */
  constructor(
    readonly request: SessionRequest | null,
    buffer: BufferOptions | undefined,
  ) {
    this.frames = new FrameBuffer(buffer);
  }

  /** Whether a missing session may be opened again. */
  get canReopen(): boolean {
    return this.request !== null && !this.deleted;
  }

  track(name: string, position: PositionLike): void {
    this.probes.set(checkName(name), Array.from(position) as unknown as Position);
    this.changed.delete(name);
  }

  untrack(name: string): void {
    this.probes.delete(checkName(name));
    this.changed.delete(name);
  }

  /** Record that the session has these points, and no others. */
  confirm(probes: SessionState["probes"]): void {
    this.changed.forEach((name) => this.differs(name, probes) || this.changed.delete(name));
  }

  /**
   * What the session's points lack or have too much: points to track, names to remove.
   *
   * In a joined session what others changed stays, unless it has no points at all, as after a restart of the server.
   */
  probesToRestore({ probes }: SessionState): { track: [string, Position][]; untrack: string[] } {
    this.confirm(probes);
    const isRestored = this.request !== null || Object.keys(probes).length === 0;
    const track = [...this.probes].filter(([name]) => (isRestored || this.changed.has(name)) && this.differs(name, probes));
    const untrack = [...this.changed].filter((name) => !this.probes.has(name));
    return { track, untrack };
  }

  private differs(name: string, probes: SessionState["probes"]): boolean {
    return String(this.probes.get(name)) !== String(probes[name]);
  }
}
