// The phone's connection: a session of its own, frames into it, and what came of them.

import { findForm, RoomLightError, type Frame, type LightForm, type Lights, type RoomLight, type Session, type Stream } from "roomlight";
import type { Api, KeptScene } from "../lib/api";

/** What the page shows of the connection. */
export interface LinkView {
  /** One line: connecting, connected, waiting for the server, ended. */
  state: string;
  kind: "idle" | "good" | "waiting" | "bad";
  sent: number;
  processed: number;
  /** Share of the sphere that was seen, 0 to 1; null before the first light. */
  coverage: number | null;
  /** Panorama of the light as a PNG. */
  panorama: Blob | null;
  problem: string;
}

export const EMPTY: LinkView = {
  state: "Not connected",
  kind: "idle",
  sent: 0,
  processed: 0,
  coverage: null,
  panorama: null,
  problem: "",
};

const PROBE = "phone";
const FORMS: readonly LightForm[] = [{ format: "png", size: 64 }];

/** Shares its view with the page: `show` is called after each change. */
abstract class Link {
  protected view: LinkView = EMPTY;

  constructor(private readonly show: (view: LinkView) => void) {}

  protected update(changes: Partial<LinkView>): void {
    this.view = { ...this.view, ...changes };
    this.show(this.view);
  }

  protected light(lights: Lights): void {
    const light = lights.results[0];
    const png = light && findForm(light, "png")?.data;
    if (light && png && lights.frame >= 0) {
      this.update({ coverage: light.coverage, panorama: new Blob([png as Uint8Array<ArrayBuffer>], { type: "image/png" }) });
    }
  }
}

/** Frames with poses, over a stream that comes back by itself. One frame is on its way at a time. */
export class StreamLink extends Link {
  private stream: Stream | null = null;
  private session: Session | null = null;
  private busy = false;

  /** Open a session and its stream. Throws RoomLightError. */
  async open(server: RoomLight, id: string): Promise<void> {
    this.update({ ...EMPTY, state: "Connecting", kind: "waiting" });
    this.session = await server.open({ id });
    const stream = await this.session.stream({
      onLighting: (lights) => this.light(lights),
      onProblem: (error) => this.update({ problem: error.message }),
      onStatus: ({ state, attempt, delay_s, error, reopened }) => {
        if (this.ending) {
          return;
        }
        if (state === "open") {
          this.update({ state: reopened ? "Connected again; the room starts anew" : "Connected", kind: "good" });
        } else if (state === "reconnecting") {
          const wait = delay_s < 1 ? "now" : `in ${Math.round(delay_s)} s`;
          this.update({ state: `No answer; trying again ${wait} (${attempt})`, kind: "waiting" });
        } else if (state === "closed") {
          this.update({ state: "Ended", kind: "idle", problem: error?.message ?? "" });
        }
      },
    });
    if (this.ending) {
      return stream.close(); // `close` was called before there was a stream
    }
    this.stream = stream;
    stream.subscribe(FORMS);
  }

  private ending = false;

  /** Whether a frame may be sent now. */
  get isFree(): boolean {
    return !this.busy && this.stream?.status.state === "open";
  }

  /** Show the light at a point: world metres, y up. */
  follow(position: readonly [number, number, number]): void {
    this.stream?.track(PROBE, position);
  }

  async send(frame: Frame): Promise<void> {
    const { stream } = this;
    if (!stream) {
      return;
    }
    this.busy = true;
    this.update({ sent: this.view.sent + 1 });
    try {
      const { status } = await stream.push(frame);
      this.update({ processed: this.view.processed + (status === "processed" ? 1 : 0), problem: "" });
    } catch (error) {
      this.update({ problem: error instanceof Error ? error.message : String(error) });
    } finally {
      this.busy = false;
    }
  }

  /** End the stream. The session stays on the server, where the live page shows it. */
  close(): void {
    this.ending = true;
    this.stream?.close();
    this.stream = null;
    this.update({ state: "Ended", kind: "idle", problem: "" });
  }
}

/** Photos without poses: each one is the whole session, because nothing says how the camera moved in between. */
export class PhotoLink extends Link {
  private session: Session | null = null;
  /** What people keep with the session: its title, and the objects they have placed. */
  private scene: KeptScene | null = null;

  constructor(
    show: (view: LinkView) => void,
    private readonly api: Api,
    private readonly id: string,
  ) {
    super(show);
  }

  /** Send a photo and show its light. Throws RoomLightError. */
  async send(photo: Frame, signal: AbortSignal): Promise<void> {
    this.update({ state: "Sending a photo", kind: "waiting" });
    try {
      if (this.session) {
        this.scene = await this.api.scene(this.id);
        await this.session.delete({ signal });
      }
    } catch (error) {
      if (!(error instanceof RoomLightError && error.status === 404)) {
        throw error; // a session that is missing needs no end
      }
    }
    this.session = await this.api.client().open({ id: this.id, signal });
    if (this.scene && (this.scene.title || this.scene.objects.length > 0)) {
      await this.api.keepScene(this.id, this.scene);
    }
    await this.session.track(PROBE, [0, 0, -1], { signal });
    this.update({ sent: this.view.sent + 1 });
    const { status } = await this.session.push({ ...photo, index: 0 }, { signal });
    this.update({ processed: this.view.processed + (status === "processed" ? 1 : 0) });
    this.light(await this.session.light({ probes: [{ name: PROBE }], forms: FORMS }, { signal }));
    this.update({ state: "Connected", kind: "good", problem: "" });
  }

  /** Show an error; photos go on. */
  failed(error: Error): void {
    this.update({ state: "No answer; trying again", kind: "waiting", problem: error.message });
  }

  close(): void {
    this.update({ state: "Ended", kind: "idle" });
  }
}
