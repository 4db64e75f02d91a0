// A session over its WebSocket: send frames, receive their results and the light of the tracked points. A lost
// connection is opened again: the server says which frames it has, and gets the others.

import { RoomLightError } from "./errors.js";
import { type Frame } from "./frame.js";
import { toJson, type ClientOptions } from "./http.js";
import { decodeLights, parseLights, type Lights } from "./light.js";
import type { KeptFrame, SessionMemory } from "./memory.js";
import { Backoff, isServerLost, isSessionGone, isTemporary } from "./reconnect.js";
import { waiting } from "./waiting.js";
import type {
  ClientMessage,
  FrameResult,
  LightAnswer,
  LightForm,
  LightingUpdate,
  LightRequest,
  Position,
  PositionLike,
  ProbesEvent,
  ServerMessage,
  SessionState,
} from "./wire.js";

/** State of a stream's connection. */
export interface StreamStatus {
  /** `closed` is final; after `reconnecting` comes `open` or `closed`. */
  readonly state: "connecting" | "open" | "reconnecting" | "closed";
  /** `reconnecting`: the number of the next attempt, from 1. */
  readonly attempt: number;
  /** `reconnecting`: the seconds until that attempt. */
  readonly delay_s: number;
  /** `reconnecting` and `closed`: why the connection ended. */
  readonly error: RoomLightError | null;
  /** `open`: the server had lost the session, so that its light starts again from the frames that are sent again. */
  readonly reopened: boolean;
  /** `open`: the server lost frames that are no longer kept here: its light differs from the light before. */
  readonly incomplete: boolean;
}

/** Handlers of messages that answer no call. */
export interface StreamOptions {
  /** Light of the tracked points after each frame, after `subscribe`. */
  onLighting?: ((update: Lights) => void) | undefined;
  /** All tracked points, after one was added, moved or removed. */
  onProbes?: ((probes: ProbesEvent["probes"]) => void) | undefined;
  /** The server refused a message. A call that waits for its answer is rejected as well. */
  onProblem?: ((error: RoomLightError) => void) | undefined;
  /** The state of the connection has changed. */
  onStatus?: ((status: StreamStatus) => void) | undefined;
  /** The stream has ended and does not connect again. */
  onClose?: ((error: RoomLightError) => void) | undefined;
  /** Closes the stream. */
  signal?: AbortSignal | undefined;
}

/** What a stream needs of its session. */
export interface SessionLink {
  readonly address: URL;
  readonly client: ClientOptions;
  readonly memory: SessionMemory;
  pack(frame: Frame): { index: number; message: Promise<Uint8Array<ArrayBuffer>> };
  /** One request for the session's state; with `reopen` it opens a missing session again. */
  resume(reopen: boolean, signal: AbortSignal): Promise<{ state: SessionState; reopened: boolean }>;
}

/** A call that waits for its answer. */
interface PendingCall {
  resolve: (answer: never) => void;
  reject: (error: unknown) => void;
  /** The message, for a call that is repeated on a new connection; frames are in the session's memory. */
  message?: ClientMessage;
  timer?: ReturnType<typeof setTimeout> | undefined;
}

type WithLights<T> = Omit<T, "results"> & Lights;
type DecodedMessage =
  Exclude<ServerMessage, LightAnswer | LightingUpdate> | WithLights<LightAnswer> | WithLights<LightingUpdate>;

const QUIET = { attempt: 0, delay_s: 0, error: null, reopened: false, incomplete: false } as const;
const MAX_SENDS = 3; // a frame that ends three connections is the reason for it
const CHECKS = 10; // how often within its time limit a call is checked for progress
const MAX_CHECKS = 40; // messages that are not its answer keep a call alive for so many after its bytes have left
const TOO_BIG = 1009; // close code of RFC 6455: a message is too big

/** A session's WebSocket. It connects again by itself; `onStatus` reports when, `onClose` that it gave up. */
export class Stream {
  private socket: WebSocket | null = null;
  private current: StreamStatus = { ...QUIET, state: "connecting" };
  private readonly pending = new Map<string, PendingCall>();
  private requests = 0;
  private received = 0; // messages of all connections
  private closedWith: RoomLightError | null = null;
  private backlogTop = -1; // frames up to this index are sent one by one: a newer one would supersede a waiting one
  private readonly backoff: Backoff;
  private readonly ended = new AbortController();

  private constructor(
    private readonly link: SessionLink,
    private readonly options: StreamOptions,
  ) {
    this.backoff = new Backoff(link.client.reconnect);
  }

  /** Connect. Rejects if the session is missing or the server does not accept the connection. */
  static async open(link: SessionLink, options: StreamOptions): Promise<Stream> {
    const { signal } = options;
    signal?.throwIfAborted();
    const stream = new Stream(link, options);
    signal?.addEventListener("abort", () => stream.close(), { once: true, signal: stream.ended.signal });
    options.onStatus?.(stream.current);
    try {
      await stream.connect(false);
    } catch (cause) {
      const error = signal?.aborted ? signal.reason : asError(cause);
      stream.finish(asError(error));
      throw error;
    }
    return stream;
  }

  /** The state of the connection. */
  get status(): StreamStatus {
    return this.current;
  }

  /** Bytes that are not yet on the network. If they grow, skip frames. */
  get bufferedAmount(): number {
    const waiting = [...this.link.memory.frames].filter(({ state }) => state === "waiting");
    return waiting.reduce((sum, { message }) => sum + message.length, this.socket?.bufferedAmount ?? 0);
  }

  /**
   * Send a frame, in the order of the calls. Resolves when the frame is processed or dropped.
   *
   * Without a connection the frame waits for the next one. The status is `queued` if the server has the frame but its
   * result was lost with the connection.
   */
  push(frame: Frame): Promise<FrameResult> {
    const { index, message } = this.link.pack(frame);
    return handled(message.then((bytes) => this.enqueue(index, bytes)));
  }

  /** Request light now; see `Session.light`. */
  light(request: LightRequest): Promise<Lights> {
    const name = `r${++this.requests}`;
    const message: ClientMessage = { type: "light", request: name, ...request };
    const answer = this.expect<Lights>(`light ${name}`, message);
    if (this.socket) {
      this.send(message);
      this.startTimer(`light ${name}`);
    }
    return handled(answer);
  }

  /** Receive the light of the tracked points in `onLighting`, now and after each frame. No forms: unsubscribe. */
  subscribe(forms: readonly LightForm[]): void {
    this.link.memory.forms = forms;
    this.send({ type: "subscribe", forms });
  }

  /** Track a point under a name of 1 to 64 letters, digits, - and _; an existing name moves to the position. */
  track(name: string, position: PositionLike): void {
    this.link.memory.track(name, position);
    this.link.memory.changed.add(name);
    this.send({ type: "track", name, position: position as Position });
  }

  /** Stop tracking a point. */
  untrack(name: string): void {
    this.link.memory.untrack(name);
    this.link.memory.changed.add(name);
    this.send({ type: "untrack", name });
  }

  /** Close the connection and reject the pending calls. The session continues to exist. */
  close(): void {
    this.finish(new RoomLightError("the stream was closed", 0));
  }

  // --- calls ---------------------------------------------------------------------------------------------------

  private enqueue(index: number, message: Uint8Array<ArrayBuffer>): Promise<FrameResult> {
    const result = this.expect<FrameResult>(`frame ${index}`);
    for (const dropped of this.link.memory.frames.add(index, message)) {
      if (dropped.state === "waiting") {
        const reason = `frame ${dropped.index} was dropped: the buffer of frames without a connection is full`;
        this.take(`frame ${dropped.index}`)?.reject(new RoomLightError(reason, 0));
      }
    }
    this.pump();
    return result;
  }

  private expect<T>(name: string, message?: ClientMessage): Promise<T> {
    if (this.closedWith) {
      throw this.closedWith;
    }
    this.take(name)?.reject(new RoomLightError(`${name} was sent again`, 0));
    return new Promise<T>((resolve, reject) => this.pending.set(name, { resolve, reject, ...(message && { message }) }));
  }

  /**
   * Start the time limit of a call that was sent now; progress on a slow network starts it again. `unsent` is the fewest
   * unsent bytes since then, `idle` and `checks` count the checks since any progress and since a byte left.
   */
  private startTimer(name: string, unsent = this.socket?.bufferedAmount ?? 0, idle = 0, checks = 0): void {
    const call = this.pending.get(name);
    if (!call) {
      return;
    }
    const { timeout_s = 30 } = this.link.client;
    const { received } = this;
    clearTimeout(call.timer);
    call.timer = setTimeout(() => {
      const still = this.socket?.bufferedAmount ?? 0;
      if (still < unsent) {
        return this.startTimer(name, still);
      }
      idle = this.received > received ? 0 : idle + 1;
      if (idle < CHECKS && checks + 1 < MAX_CHECKS) {
        return this.startTimer(name, unsent, idle, checks + 1);
      }
      const error = new RoomLightError(`${name}: no answer in ${timeout_s} s`, 0);
      if (call.message) {
        this.take(name)?.reject(error);
      }
      this.drop(error); // without its network it says nothing either; the next one tells whether a frame has arrived
    }, (timeout_s * 1000) / CHECKS);
  }

  /** Send the frames that wait, in order. */
  private pump(): void {
    let underway = false;
    for (const frame of this.link.memory.frames) {
      if (!this.socket || (frame.index <= this.backlogTop && underway)) {
        return;
      }
      if (frame.state === "waiting") {
        this.sendFrame(frame);
      }
      underway ||= frame.state === "sent";
      if (underway && frame.index <= this.backlogTop) {
        return;
      }
    }
  }

  private sendFrame(frame: KeptFrame): void {
    if (frame.sends >= MAX_SENDS) {
      const error = new RoomLightError(`frame ${frame.index}: the connection ended ${frame.sends} times after it`, 0);
      this.link.memory.frames.remove(frame.index);
      return void this.take(`frame ${frame.index}`)?.reject(error);
    }
    frame.state = "sent";
    frame.sends++;
    this.socket?.send(frame.message);
    this.startTimer(`frame ${frame.index}`);
  }

  /** Send a message on an open connection; a later connection restores what it would have changed. */
  private send(message: ClientMessage): void {
    if (this.closedWith) {
      throw this.closedWith;
    }
    this.socket?.send(toJson(message));
  }

  /** Remove a pending call and return it. */
  private take(name: string): PendingCall | undefined {
    const call = this.pending.get(name);
    this.pending.delete(name);
    clearTimeout(call?.timer);
    return call;
  }

  // --- messages ------------------------------------------------------------------------------------------------

  private receive(data: string | ArrayBuffer): void {
    this.received++;
    let message: DecodedMessage;
    try {
      message = decode(data);
    } catch (cause) {
      return this.options.onProblem?.(new RoomLightError("malformed message from the server", 0, null, { cause }));
    }
    if (message.type !== "problem") {
      this.backoff.reset(); // only now: a proxy may accept connections without a server behind it
    }
    switch (message.type) {
      case "frame":
        this.link.memory.frames.settle(message);
        this.take(`frame ${message.index}`)?.resolve(message as never);
        return this.pump();
      case "light":
        return this.take(`light ${message.request}`)?.resolve(message as never);
      case "lighting":
        return this.options.onLighting?.(message);
      case "probes":
        this.link.memory.confirm(message.probes);
        return this.options.onProbes?.(message.probes);
      case "problem":
        return this.refused(RoomLightError.fromProblem(message.problem), message.index ?? null, message.request ?? null);
    }
  }

  private refused(error: RoomLightError, index: number | null, request: string | null): void {
    const { frames } = this.link.memory;
    const frame = index === null ? undefined : frames.find(index);
    const stopping = isServerLost(error);
    if ((stopping || isSessionGone(error)) && this.link.client.reconnect !== false) {
      if (stopping && frame) {
        frame.sends--; // not the reason for the end of the connection
      }
      return this.drop(error); // what was sent is sent again, to the session's next server, or as it is restored
    }
    if (index !== null && frame && frame.sends > 1 && error.kind === "frame-conflict") {
      frame.state = "done"; // it had arrived over the previous connection
      this.take(`frame ${index}`)?.resolve(outcomeLost(index) as never);
      return this.pump();
    }
    if (index !== null) {
      frames.remove(index);
    }
    this.take(index === null ? `light ${request}` : `frame ${index}`)?.reject(error);
    this.options.onProblem?.(error);
    this.pump();
  }

  // --- connection ----------------------------------------------------------------------------------------------

  private async connect(again: boolean): Promise<void> {
    const { signal } = this.ended;
    const { state, reopened } = await this.link.resume(again && this.link.memory.canReopen, signal);
    if (state.status === "failed") {
      throw new RoomLightError("the session has failed on the server: delete it and open a new one", 409);
    }
    const socket = await openSocket(this.link, signal);
    this.socket = socket;
    socket.onmessage = (event) => this.socket === socket && this.receive(event.data as string | ArrayBuffer);
    socket.onerror = null;
    socket.onclose = ({ code, reason }) => {
      if (this.socket === socket) {
        this.lost(new RoomLightError(`${this.link.address}: closed (${code}${reason && `: ${reason}`})`, 0), code, reason);
      }
    };
    const incomplete = this.link.memory.frames.lacks(state.frames.last_index ?? -1);
    this.show({ ...QUIET, state: "open", reopened, incomplete });
    this.restore(state);
  }

  /** Bring the session up to date: frames above its last index, points, subscription, waiting requests. */
  private restore(state: SessionState): void {
    const { memory } = this.link;
    const last = state.frames.last_index ?? -1;
    for (const frame of [...memory.frames]) {
      if (frame.index > last) {
        frame.state = "waiting";
        this.backlogTop = Math.max(this.backlogTop, frame.index);
      } else if (frame.state === "sent") {
        frame.state = "done";
        this.take(`frame ${frame.index}`)?.resolve(outcomeLost(frame.index) as never);
      }
    }
    const probes = memory.probesToRestore(state);
    probes.untrack.forEach((name) => this.send({ type: "untrack", name }));
    probes.track.forEach(([name, position]) => this.send({ type: "track", name, position }));
    if (memory.forms.length > 0) {
      this.send({ type: "subscribe", forms: memory.forms });
    }
    for (const [name, call] of [...this.pending]) {
      if (call.message) {
        this.send(call.message);
        this.startTimer(name);
      } else if (!memory.frames.find(Number(name.slice("frame ".length)))) {
        this.take(name)?.reject(new RoomLightError(`${name}: lost with its connection, and no longer in the buffer`, 0));
      }
    }
    this.pump();
  }

  /** Leave a connection that is of no use any more. */
  private drop(error: RoomLightError): void {
    this.socket?.close();
    this.lost(error, 0, "");
  }

  private lost(error: RoomLightError, code: number, reason: string): void {
    if (this.closedWith || !this.socket) {
      return;
    }
    this.socket = null;
    this.pending.forEach(({ timer }) => clearTimeout(timer));
    if (code === TOO_BIG) {
      for (const { index } of [...this.link.memory.frames].filter(({ state }) => state === "sent")) {
        this.link.memory.frames.remove(index);
        this.take(`frame ${index}`)?.reject(error);
      }
    }
    if (reason === "session-failed" || code === 4422) {
      return this.finish(error);
    }
    void this.reconnect(error);
  }

  private async reconnect(error: RoomLightError): Promise<void> {
    for (;;) {
      const delay_s = this.backoff.next();
      if (delay_s === null) {
        return this.finish(error);
      }
      this.show({ ...QUIET, state: "reconnecting", attempt: this.backoff.attempt, delay_s, error });
      try {
        await waiting.delay(delay_s, this.ended.signal);
        return await this.connect(true);
      } catch (cause) {
        error = asError(cause);
        if (this.closedWith || !isTemporary(error)) {
          return this.finish(error);
        }
      }
    }
  }

  private show(status: StreamStatus): void {
    this.current = status;
    this.options.onStatus?.(status);
  }

  private finish(error: RoomLightError): void {
    if (this.closedWith) {
      return;
    }
    this.closedWith = error;
    this.ended.abort(error);
    this.socket?.close();
    this.socket = null;
    for (const name of [...this.pending.keys()]) {
      this.take(name)?.reject(error);
    }
    this.show({ ...QUIET, state: "closed", error });
    this.options.onClose?.(error);
  }
}

/** An open WebSocket. Rejects if there is no connection within the client's time limit. */
function openSocket({ address, client }: SessionLink, signal: AbortSignal): Promise<WebSocket> {
  return new Promise((resolve, reject) => {
    signal.throwIfAborted();
    const SocketClass = client.WebSocket ?? globalThis.WebSocket;
    if (!SocketClass) {
      throw new RoomLightError("no WebSocket here: start Node 20 with --experimental-websocket, or give the option WebSocket", 0);
    }
    // Browsers cannot set headers here: the token is sent as a second subprotocol, and the server accepts the first.
    const protocols = ["roomlight.v1", ...(client.token ? [`bearer.${client.token}`] : [])];
    const socket = new SocketClass(address, protocols);
    socket.binaryType = "arraybuffer";
    const stop = () => fail("closed by the app");
    const end = () => {
      clearTimeout(timer);
      signal.removeEventListener("abort", stop);
    };
    const fail = (reason: string) => {
      end();
      socket.onopen = socket.onerror = socket.onclose = null; // closing calls them again
      socket.close();
      reject(new RoomLightError(`${address}: ${reason}`, 0));
    };
    const { timeout_s = 30 } = client;
    const timer = setTimeout(() => fail(`no connection in ${timeout_s} s`), timeout_s * 1000);
    signal.addEventListener("abort", stop, { once: true });
    socket.onopen = () => (end(), resolve(socket));
    socket.onerror = () => fail("no connection"); // Node 20 gives no reason for a failed connection
    socket.onclose = ({ code, reason }) => fail(`closed (${code}${reason && `: ${reason}`})`);
  });
}

function decode(data: string | ArrayBuffer): DecodedMessage {
  if (typeof data !== "string") {
    return parseLights<LightAnswer | LightingUpdate>(data) as DecodedMessage;
  }
  const message = JSON.parse(data) as ServerMessage;
  return message.type === "light" || message.type === "lighting" ? (decodeLights(message) as DecodedMessage) : message;
}

/** The result of a frame that arrived, but whose own result was lost with the connection. */
function outcomeLost(index: number): FrameResult {
  return { index, status: "queued", replay: true, depth_estimated: false, stage_ms: {}, coverage: {} };
}

function asError(cause: unknown): RoomLightError {
  return cause instanceof RoomLightError ? cause : new RoomLightError(String(cause), 0, null, { cause });
}

/** Mark a promise as handled: if the caller ignores it, an error reaches `onClose` or `onProblem` only. */
function handled<T>(promise: Promise<T>): Promise<T> {
  promise.catch(() => undefined);
  return promise;
}
