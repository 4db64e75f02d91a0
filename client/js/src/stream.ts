// A session over its WebSocket: frames in, their fate and the followed points' light out, without asking.

import { RoomLightError } from "./errors.js";
import { packFrame, type Frame } from "./frame.js";
import type { ClientOptions } from "./http.js";
import { decodeLights, parseLights, type Lights } from "./light.js";
import type {
  ClientMessage,
  LightForm,
  FrameResult,
  LightAnswer,
  LightingUpdate,
  LightRequest,
  Position,
  ProbesEvent,
  ServerMessage,
} from "./wire.js";

/** What happens without being asked for. */
export interface StreamOptions {
  /** Light of the followed points, after each frame, once subscribed. */
  onLighting?: (update: Lights) => void;
  /** The followed points, after one was added, moved or removed. */
  onProbes?: (probes: ProbesEvent["probes"]) => void;
  /** A message was refused. Calls that wait for an answer to it are rejected as well. */
  onProblem?: (error: RoomLightError) => void;
  onClose?: (error: RoomLightError) => void;
  signal?: AbortSignal;
}

interface Waiting {
  resolve: (answer: never) => void;
  reject: (error: unknown) => void;
  timer: ReturnType<typeof setTimeout>;
}

type Lit<T> = Omit<T, "results"> & Lights;
type Received = Exclude<ServerMessage, LightAnswer | LightingUpdate> | Lit<LightAnswer> | Lit<LightingUpdate>;

/** An open WebSocket. It is not opened again by itself: `onClose` tells, and `session.stream()` makes a new one. */
export class Stream {
  private readonly waiting = new Map<string, Waiting>();
  private requests = 0;
  private order: Promise<unknown> = Promise.resolve();
  private end: RoomLightError | null = null;

  private constructor(
    private readonly socket: WebSocket,
    private readonly options: StreamOptions,
    private readonly numbered: (frame: Frame) => Frame & { index: number },
    private readonly timeout_s: number,
  ) {}

  /** Connect; rejects if the server does not take the connection. */
  static open(
    address: URL,
    client: ClientOptions,
    options: StreamOptions,
    numbered: (frame: Frame) => Frame & { index: number },
  ): Promise<Stream> {
    const { signal } = options;
    return new Promise((resolve, reject) => {
      signal?.throwIfAborted();
      const make = client.WebSocket ?? WebSocket;
      // A browser can set no headers here: the token goes as a second subprotocol, and the server answers the first.
      const socket = new make(address, ["roomlight.v1", ...(client.token ? [`bearer.${client.token}`] : [])]);
      socket.binaryType = "arraybuffer";
      const stream = new Stream(socket, options, numbered, client.timeout_s ?? 30);
      const abort = () => socket.close();
      signal?.addEventListener("abort", abort, { once: true });
      socket.onopen = () => resolve(stream);
      socket.onmessage = (event) => stream.receive(event.data as string | ArrayBuffer);
      const end = (why: string) => {
        signal?.removeEventListener("abort", abort);
        const error = new RoomLightError(`${address}: ${why}`, 0);
        reject(signal?.aborted ? signal.reason : error); // of no effect once it was open
        stream.finish(error);
      };
      socket.onerror = () => end("no connection"); // Node 20 tells no more than this where nobody answers
      socket.onclose = ({ code, reason }) => end(`closed (${code}${reason && `: ${reason}`})`);
    });
  }

  /** Bytes not yet on the network: over a slow one, leave a frame out rather than add to them. */
  get bufferedAmount(): number {
    return this.socket.bufferedAmount;
  }

  /** Send a frame, in the order of the calls; resolves when its fate is known. */
  push(frame: Frame): Promise<FrameResult> {
    const numbered = this.numbered(frame);
    const packed = packFrame(numbered);
    const turn = this.order.then(() => packed); // reading a Blob takes its time, and an older index is refused
    this.order = turn.catch(() => undefined);
    return quiet(turn.then((message) => this.ask<FrameResult>(`frame ${numbered.index}`, message)));
  }

  /** Light now, as `Session.light`. */
  light(request: LightRequest): Promise<Lights> {
    const name = `r${++this.requests}`;
    return quiet(this.ask<Lights>(`light ${name}`, { type: "light", request: name, ...request }));
  }

  /** Light of the followed points, now and after each frame, to `onLighting`; no forms: no more. */
  subscribe(forms: readonly LightForm[]): void {
    this.send({ type: "subscribe", forms });
  }

  track(name: string, position: Position): void {
    this.send({ type: "track", name, position });
  }

  untrack(name: string): void {
    this.send({ type: "untrack", name });
  }

  /** Close; what is still waited for is rejected. The session lives on. */
  close(): void {
    this.socket.close();
    this.finish(new RoomLightError("the stream was closed", 0));
  }

  private ask<T>(name: string, message: ClientMessage | Uint8Array<ArrayBuffer>): Promise<T> {
    return new Promise<T>((resolve, reject) => {
      this.send(message);
      this.settle(name)?.reject(new RoomLightError(`${name} was sent again`, 0));
      const late = () => this.settle(name)?.reject(new RoomLightError(`${name}: no answer in ${this.timeout_s} s`, 0));
      this.waiting.set(name, { resolve, reject, timer: setTimeout(late, this.timeout_s * 1000) });
    });
  }

  private send(message: ClientMessage | Uint8Array<ArrayBuffer>): void {
    if (this.end) {
      throw this.end;
    }
    this.socket.send(message instanceof Uint8Array ? message : JSON.stringify(message));
  }

  private receive(data: string | ArrayBuffer): void {
    let message: Received;
    try {
      message = read(data);
    } catch (cause) {
      return this.options.onProblem?.(new RoomLightError("a message that cannot be read", 0, null, { cause }));
    }
    switch (message.type) {
      case "frame":
        return this.settle(`frame ${message.index}`)?.resolve(message as never);
      case "light":
        return this.settle(`light ${message.request}`)?.resolve(message as never);
      case "lighting":
        return this.options.onLighting?.(message);
      case "probes":
        return this.options.onProbes?.(message.probes);
      case "problem": {
        const error = RoomLightError.of(message.problem);
        this.settle(message.index != null ? `frame ${message.index}` : `light ${message.request}`)?.reject(error);
        return this.options.onProblem?.(error);
      }
    }
  }

  private settle(name: string): Waiting | undefined {
    const found = this.waiting.get(name);
    this.waiting.delete(name);
    clearTimeout(found?.timer);
    return found;
  }

  private finish(error: RoomLightError): void {
    if (this.end) {
      return;
    }
    this.end = error;
    for (const name of [...this.waiting.keys()]) {
      this.settle(name)?.reject(error);
    }
    this.options.onClose?.(error);
  }
}

function read(data: string | ArrayBuffer): Received {
  if (typeof data !== "string") {
    return parseLights<LightAnswer | LightingUpdate>(data) as Received;
  }
  const message = JSON.parse(data) as ServerMessage;
  return message.type === "light" || message.type === "lighting" ? (decodeLights(message) as Received) : message;
}

/** Who pushes without waiting hears of a loss by `onClose` and `onProblem`, not as an uncaught error of the page. */
function quiet<T>(promise: Promise<T>): Promise<T> {
  promise.catch(() => undefined);
  return promise;
}
