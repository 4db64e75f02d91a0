// The selected session: its stream, and what is read again after each frame.

import { RoomLightError, type HistoryList, type Light, type Lights, type Position, type Session, type Stream, type StreamStatus } from "roomlight";
import { isAway, isGone, sessionPath, type Api } from "./lib/api";
import { FORMS, probeLight } from "./lib/light_data";
import { latestOnly } from "./lib/signal";
import type { ProbeLight, State } from "./state";

const FIRST_PROBE = "probe-1";
const MESH_PAUSE_MS = 1500; // a mesh changes with a keyframe, not with each frame
const TOGETHER_MS = 100; // new light waits so long for the picture and the camera of its frame
const REJOIN_MS = 250;
const MISSING_MS = 3000; // a phone that sends photos replaces its session for each

/** Joins a session, keeps the state up to date, and ends with `close`. */
export class LiveSession {
  session: Session | null = null;
  private stream: Stream | null = null;
  private readonly stopped = new AbortController();
  private missingSince: number | null = null;
  private isReplaced = false; // what is shown is of an earlier session with this id, until a frame arrives
  private etags = { picture: "", mesh: "" };
  private held: string | null = null;
  private pendingMove: { name: string; position: Position } | null = null;
  private stride = 1; // of the history that is shown; 0: all of it is read again
  private isAway = false;
  private received = 0; // messages with light
  private shown = 0; // the newest of them that is shown
  private hadProbe = false; // this page shows or has removed one: it then adds none by itself
  private readonly removed = new Set<string>(); // by this page, so that light on its way does not show them again
  private readonly awaited = new Set<string>(); // new probes without light so far
  private arrived: ReadonlyMap<string, ProbeLight> | null = null; // the newest light of all probes, not shown yet

  constructor(
    private readonly api: Api,
    private readonly state: State,
    readonly id: string,
    private readonly report: (error: unknown) => void,
    private readonly onJoined: () => void,
    private readonly onOpen: () => void,
  ) {}

  /** Whether frames, light and errors of this session are no longer wanted. */
  get closed(): boolean {
    return this.stopped.signal.aborted;
  }

  async open(): Promise<void> {
    try {
      const session = await this.api.client().join(this.id, { signal: this.stopped.signal });
      const isBack = this.session !== null;
      this.session = session;
      if (isBack) {
        this.isReplaced = true;
        this.etags = { picture: "", mesh: "" };
        this.removed.clear();
      }
      this.onJoined();
      this.refresh();
      this.stream = await session.stream({
        signal: this.stopped.signal,
        onLighting: (update) => void this.receive(update),
        onProbes: (probes) => this.forgetProbes(Object.keys(probes)),
        onProblem: (error) => this.refused(error),
        onStatus: (status) => this.showStatus(status),
        onClose: (error) => this.stream && void this.end(error),
      });
      this.missingSince = null;
      this.onOpen();
      if (isBack) {
        this.state.liveProbes.value.forEach(({ name, position }) => this.stream?.track(name, position));
      }
      this.stream.subscribe(FORMS);
      void this.guarded(() => this.addFirstProbe());
    } catch (error) {
      await this.end(error);
    }
  }

  close(): void {
    this.stopped.abort(new DOMException("the page shows another session", "AbortError"));
  }

  /** Read the picture, the camera and the history again, and the mesh less often. */
  refresh(): void {
    if (!this.closed) {
      this.refreshFrame();
    }
  }

  private readonly refreshFrame = latestOnly(() => this.guarded(() => this.readFrame()));
  private readonly refreshMesh = latestOnly(() => this.guarded(() => this.readMesh()), MESH_PAUSE_MS);

  /** Add a probe, or move one. */
  track(name: string, position: Position): void {
    this.pendingMove = { name, position };
    this.awaited.add(name);
    this.removed.delete(name);
    this.stream?.track(name, position);
  }

  /** Whether a probe of this session has the name, also one whose light has not arrived. */
  hasProbe(name: string): boolean {
    return this.state.liveProbes.value.has(name) || this.awaited.has(name);
  }

  untrack(name: string): void {
    this.hadProbe = true;
    this.awaited.delete(name);
    this.removed.add(name);
    this.stream?.untrack(name);
  }

  /** The light of a probe while it is dragged: the newest position only, one request at a time. */
  preview(name: string, position: Position): void {
    this.held = name;
    this.pendingMove = { name, position };
    this.show(name, position);
    this.requestPreview();
  }

  /** The light at points of the room; null while there is no connection, and once the session is closed. */
  async lightAt(positions: readonly Position[]): Promise<readonly Light[] | null> {
    const probes = positions.map((position) => ({ position }));
    if (this.stream?.status.state !== "open") {
      return null;
    }
    try {
      return (await this.stream.light({ probes, forms: [{ format: "hdr" }, { format: "hdr", use: "reflection" }] })).results;
    } catch (error) {
      if (this.closed) {
        return null;
      }
      throw error;
    }
  }

  /** The end of a drag: the server tracks the probe at its new place. */
  release(name: string, position: Position): void {
    this.show(name, position);
    this.track(name, position);
    this.held = null;
  }

  private readonly requestPreview = latestOnly(() =>
    this.guarded(async () => {
      const move = this.pendingMove;
      if (!move || !this.stream) {
        return;
      }
      const { results, frame } = await this.stream.light({ probes: [{ position: move.position }], forms: FORMS });
      const light = results[0] && (await probeLight(move.name, frame, results[0]));
      const latest = this.state.liveProbes.value.get(move.name);
      if (light && latest && this.held === move.name) {
        this.setProbe({ ...light, position: latest.position });
      }
    }),
  );

  private async receive(update: Lights): Promise<void> {
    if (this.isReplaced && update.frame < 0) {
      return;
    }
    const order = ++this.received;
    const lights = await Promise.all(update.results.map((light) => probeLight(light.name ?? "", update.frame, light)));
    if (this.closed || order < this.shown) {
      return; // a newer message was decoded first
    }
    this.shown = order;
    this.arrived = new Map(lights.map((light) => [light.name, light]));
    setTimeout(() => this.showArrived(), TOGETHER_MS);
    this.refresh();
  }

  /** Show the light that has arrived: with the picture and the camera, so that the screen changes once. */
  private showArrived(): void {
    const { arrived, held } = this;
    if (!arrived || this.closed) {
      return;
    }
    const next = new Map([...this.state.liveProbes.value].filter(([name]) => arrived.has(name) || name === held)); // the others were removed
    for (const light of arrived.values()) {
      if (light.name && light.name !== held && !this.removed.has(light.name)) {
        next.set(light.name, light);
      }
    }
    this.removed.forEach((name) => arrived.has(name) || this.removed.delete(name));
    this.arrived = null;
    this.state.liveProbes.value = next;
    this.hadProbe ||= next.size > 0;
    next.forEach((_, name) => this.awaited.delete(name));
    this.selectShown();
  }

  /** Select another probe if the selected one is gone. */
  private selectShown(): void {
    const { selectedProbe, liveProbes } = this.state;
    const selected = selectedProbe.value ?? "";
    if (liveProbes.value.has(selected) || this.awaited.has(selected)) {
      return;
    }
    const wanted = this.state.wantedProbe;
    const shown = wanted !== null && liveProbes.value.has(wanted) ? wanted : (liveProbes.value.keys().next().value ?? null);
    selectedProbe.value = shown;
    if (shown !== null) { // light arrives for all probes at once
      this.state.wantedProbe = null; // what is deleted later is not wanted any more
      if (wanted !== null && shown !== wanted) {
        this.report(new Error(`The address names the probe ${wanted}, which this session does not have: ${shown} is shown.`));
      }
    }
  }

  private refused(error: RoomLightError): void {
    this.awaited.clear();
    this.selectShown();
    this.report(error);
  }

  private forgetProbes(names: readonly string[]): void {
    const kept = new Map([...this.state.liveProbes.value].filter(([name]) => this.isReplaced || names.includes(name)));
    if (kept.size !== this.state.liveProbes.value.size) {
      this.state.liveProbes.value = kept;
      this.selectShown();
    }
    this.stream?.subscribe(FORMS); // sends the light of a new probe at once
  }

  private show(name: string, position: Position): void {
    const light = this.state.liveProbes.value.get(name);
    if (light) {
      this.setProbe({ ...light, position });
    }
  }

  private setProbe(light: ProbeLight): void {
    this.state.liveProbes.value = new Map(this.state.liveProbes.value).set(light.name, light);
  }

  private async readFrame(): Promise<void> {
    const { session } = this;
    const last = this.isReplaced ? -1 : (this.state.history.value.at(-1)?.index ?? -1);
    const [camera, history] = await Promise.all([this.api.camera(this.id), this.api.history(this.id, last)]);
    const hasFrame = camera.camera_to_world !== null;
    const picture = hasFrame ? await this.api.file(`${sessionPath(this.id)}/colour`, this.etags.picture) : null;
    if (this.closed || session !== this.session) {
      return;
    }
    this.showArrived();
    if (hasFrame || !this.isReplaced) {
      this.state.camera.value = camera;
    }
    if (picture) {
      this.etags.picture = picture.etag;
      this.state.picture.value = { blob: picture.blob, frame: picture.frame };
    }
    await this.addHistory(history);
    if (hasFrame) {
      this.refreshMesh();
      await this.addFirstProbe();
    }
  }

  private async addHistory(update: HistoryList): Promise<void> {
    let { entries } = update;
    const known = this.isReplaced ? [] : this.state.history.value;
    if (update.stride !== this.stride && known.length > 0) {
      ({ entries } = await this.api.history(this.id, -1)); // entries were removed in between
      if (this.closed) {
        return;
      }
      this.state.shownEntry.value = null;
      this.state.history.value = entries;
    } else if (entries.length > 0) {
      if (this.isReplaced) {
        this.isReplaced = false;
        this.state.shownEntry.value = null;
      }
      this.state.history.value = [...known, ...entries];
    }
    this.stride = update.stride;
  }

  /** A session that has had no probe gets one in front of its camera, so that there is light to look at. */
  private async addFirstProbe(): Promise<void> {
    const pose = this.state.camera.value?.camera_to_world;
    if (!this.stream || !this.session || !pose || this.hadProbe || this.pendingMove) {
      return;
    }
    const { probes } = await this.session.state();
    if (Object.keys(probes).length === 0 && !this.pendingMove) {
      const ahead = [0, 1, 2].map((axis) => pose[12 + axis]! - 1.2 * pose[8 + axis]!);
      this.track(FIRST_PROBE, ahead as unknown as Position);
    }
  }

  private async readMesh(): Promise<void> {
    const mesh = await this.api.file(`${sessionPath(this.id)}/mesh?triangles=${this.state.meshTriangles.value}`, this.etags.mesh);
    if (mesh && !this.closed) {
      this.etags.mesh = mesh.etag;
      this.state.mesh.value = await mesh.blob.arrayBuffer();
    }
  }

  /** Show the state of the stream, after the server was not reachable otherwise. */
  showConnection(): void {
    if (this.stream) {
      this.showStatus(this.stream.status);
    }
  }

  private showStatus({ state, delay_s }: StreamStatus): void {
    if (this.closed) {
      return;
    }
    if (state === "open" && this.isAway) {
      this.stride = 0; // of a server that was started again: its history is another one
      this.refresh();
    }
    this.isAway = state === "reconnecting";
    const { connection } = this.state;
    if (state === "open" && connection.value.text !== "Live") {
      connection.value = { state: "live", text: "Live" }; // once: a screen reader says it each time
    } else if (state === "reconnecting") {
      const text = delay_s >= 1 ? `Reconnecting in ${Math.round(delay_s)} s` : "Reconnecting";
      connection.value = { state: "reconnecting", text };
    }
  }

  /** Show why the session is not shown. Where it is missing, wait first whether it comes back. */
  private async end(error: unknown): Promise<void> {
    if (this.closed) {
      return;
    }
    const gone = error instanceof RoomLightError && (error.status === 404 || isGone(error));
    this.stream = null;
    this.missingSince ??= performance.now();
    if (gone && performance.now() - this.missingSince < MISSING_MS) {
      await new Promise((resolve) => setTimeout(resolve, REJOIN_MS));
      return this.closed ? undefined : this.open();
    }
    this.close();
    const reason = String(error instanceof Error ? error.message : error);
    const missing =
      this.state.camera.value === null // nothing of it was ever read
        ? { title: "There is no session of this name", text: `Check the link: it names the session ${this.id}.` }
        : { title: "The session has ended", text: "It was idle for too long, it was deleted, or the server was started again." };
    this.state.ended.value = gone
      ? missing
      : { title: "The session cannot be reached", text: `The page tries again while the server lists it. The reason: ${reason}` };
  }

  /** Errors of a lost connection are shown by the stream's state; others are reported. */
  private async guarded(work: () => Promise<void>): Promise<void> {
    try {
      await work();
    } catch (error) {
      const isExpected = error instanceof RoomLightError && (isAway(error) || error.status === 404 || error.kind === "no-frame");
      if (!this.closed && !isExpected) {
        this.report(error);
      }
    }
  }
}
