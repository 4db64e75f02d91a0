// A session over its WebSocket: send frames, receive their results and the light of the tracked points.

import { RoomLightError } from "./errors.js";
import { packFrame, type Frame } from "./frame.js";
import type { ClientOptions } from "./http.js";
import { decodeLights, parseLights, type Lights } from "./light.js";
import type {
  ClientMessage,
  FrameResult,
  LightAnswer,
  LightForm,
  LightingUpdate,
  LightRequest,
  Position,
  ProbesEvent,
  ServerMessage,
} from "./wire.js";

/** Handlers of messages that answer no call. */
export interface StreamOptions {
  /** Light of the tracked points after each frame, after `subscribe`. */
  onLighting?: (update: Lights) => void;
  /** All tracked points, after one was added, moved or removed. */
  onProbes?: (probes: ProbesEvent["probes"]) => void;
  /** The server refused a message. A call that waits for its answer is rejected as well. */
  onProblem?: (error: RoomLightError) => void;
  /** The connection was closed. */
  onClose?: (error: RoomLightError) => void;
  /** Closes the stream. */
  signal?: AbortSignal;
}

/** A call that waits for its answer. */
interface PendingCall {
  resolve: (answer: never) => void;
  reject: (error: unknown) => void;
  timer: ReturnType<typeof setTimeout>;
}

type WithLights<T> = Omit<T, "results"> & Lights;
type DecodedMessage =
  Exclude<ServerMessage, LightAnswer | LightingUpdate> | WithLights<LightAnswer> | WithLights<LightingUpdate>;

/** An open WebSocket. It does not reconnect: `onClose` reports the end, and `session.stream()` opens a new one. */
export class Stream {
  private readonly pending = new Map<string, PendingCall>();
  private requests = 0;
  private lastPush: Promise<unknown> = Promise.resolve();
  private closedWith: RoomLightError | null = null;

  private constructor(
    private readonly socket: WebSocket,
    private readonly options: StreamOptions,
    private readonly withIndex: (frame: Frame) => Frame & { index: number },
    private readonly timeout_s: number,
  ) {}

  /** Connect. Rejects if the server does not accept the connection. */
  static open(
    address: URL,
    client: ClientOptions,
    options: StreamOptions,
    withIndex: (frame: Frame) => Frame & { index: number },
  ): Promise<Stream> {
    const { signal } = options;
    return new Promise((resolve, reject) => {
      signal?.throwIfAborted();
      const SocketClass = client.WebSocket ?? WebSocket;
      // Browsers cannot set headers here: the token is sent as a second subprotocol, and the server accepts the first.
      const protocols = ["roomlight.v1", ...(client.token ? [`bearer.${client.token}`] : [])];
      const socket = new SocketClass(address, protocols);
      socket.binaryType = "arraybuffer";
      const stream = new Stream(socket, options, withIndex, client.timeout_s ?? 30);
      const abort = () => socket.close();
      signal?.addEventListener("abort", abort, { once: true });
      socket.onopen = () => resolve(stream);
      socket.onmessage = (event) => stream.receive(event.data as string | ArrayBuffer);
      const end = (reason: string) => {
        signal?.removeEventListener("abort", abort);
        const error = new RoomLightError(`${address}: ${reason}`, 0);
        reject(signal?.aborted ? signal.reason : error); // has no effect after `resolve`
        stream.finish(error);
      };
      socket.onerror = () => end("no connection"); // Node 20 gives no reason for a failed connection
      socket.onclose = ({ code, reason }) => end(`closed (${code}${reason && `: ${reason}`})`);
    });
  }

  /** Bytes that are not yet on the network. If they grow, skip frames. */
  get bufferedAmount(): number {
    return this.socket.bufferedAmount;
  }

  /** Send a frame, in the order of the calls. Resolves when the frame is processed or dropped. */
  push(frame: Frame): Promise<FrameResult> {
    const indexed = this.withIndex(frame);
    const packed = packFrame(indexed);
    // A frame with a Blob takes longer to pack, but the server refuses an index below the last one.
    const inOrder = this.lastPush.then(() => packed);
    this.lastPush = inOrder.catch(() => undefined);
    return handled(inOrder.then((message) => this.request<FrameResult>(`frame ${indexed.index}`, message)));
  }

  /** Request light now; see `Session.light`. */
  light(request: LightRequest): Promise<Lights> {
    const name = `r${++this.requests}`;
    return handled(this.request<Lights>(`light ${name}`, { type: "light", request: name, ...request }));
  }

  /** Receive the light of the tracked points in `onLighting`, now and after each frame. No forms: unsubscribe. */
  subscribe(forms: readonly LightForm[]): void {
    this.send({ type: "subscribe", forms });
  }

  /** Track a point under a name; an existing name moves to the position. */
  track(name: string, position: Position): void {
    this.send({ type: "track", name, position });
  }

  /** Stop tracking a point. */
  untrack(name: string): void {
    this.send({ type: "untrack", name });
  }

  /** Close the connection and reject the pending calls. The session continues to exist. */
  close(): void {
    this.socket.close();
    this.finish(new RoomLightError("the stream was closed", 0));
  }

  private request<T>(name: string, message: ClientMessage | Uint8Array<ArrayBuffer>): Promise<T> {
    return new Promise<T>((resolve, reject) => {
      this.send(message);
      this.takePending(name)?.reject(new RoomLightError(`${name} was sent again`, 0));
      const timeout = () =>
        this.takePending(name)?.reject(new RoomLightError(`${name}: no answer in ${this.timeout_s} s`, 0));
      this.pending.set(name, { resolve, reject, timer: setTimeout(timeout, this.timeout_s * 1000) });
    });
  }

  private send(message: ClientMessage | Uint8Array<ArrayBuffer>): void {
    if (this.closedWith) {
      throw this.closedWith;
    }
    this.socket.send(message instanceof Uint8Array ? message : JSON.stringify(message));
  }

  private receive(data: string | ArrayBuffer): void {
    let message: DecodedMessage;
    try {
      message = decode(data);
    } catch (cause) {
      return this.options.onProblem?.(new RoomLightError("malformed message from the server", 0, null, { cause }));
    }
    switch (message.type) {
      case "frame":
        return this.takePending(`frame ${message.index}`)?.resolve(message as never);
      case "light":
        return this.takePending(`light ${message.request}`)?.resolve(message as never);
      case "lighting":
        return this.options.onLighting?.(message);
      case "probes":
        return this.options.onProbes?.(message.probes);
      case "problem": {
        const error = RoomLightError.fromProblem(message.problem);
        const call = message.index != null ? `frame ${message.index}` : `light ${message.request}`;
        this.takePending(call)?.reject(error);
        return this.options.onProblem?.(error);
      }
    }
  }

  /** Remove a pending call and return it. */
  private takePending(name: string): PendingCall | undefined {
    const call = this.pending.get(name);
    this.pending.delete(name);
    clearTimeout(call?.timer);
    return call;
  }

  private finish(error: RoomLightError): void {
    if (this.closedWith) {
      return;
    }
    this.closedWith = error;
    for (const name of [...this.pending.keys()]) {
      this.takePending(name)?.reject(error);
    }
    this.options.onClose?.(error);
  }
}

function decode(data: string | ArrayBuffer): DecodedMessage {
  if (typeof data !== "string") {
    return parseLights<LightAnswer | LightingUpdate>(data) as DecodedMessage;
  }
  const message = JSON.parse(data) as ServerMessage;
  return message.type === "light" || message.type === "lighting" ? (decodeLights(message) as DecodedMessage) : message;
}

/** Mark a promise as handled: if the caller ignores it, an error reaches `onClose` or `onProblem` only. */
function handled<T>(promise: Promise<T>): Promise<T> {
  promise.catch(() => undefined);
  return promise;
}
