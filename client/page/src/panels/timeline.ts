// The timeline: thumbnails, time per frame, lost frames; scrubbing shows an earlier frame in all panels.

import { parseHdr, type HistoryEntry } from "roomlight";
import { sessionPath, type Api } from "../lib/api";
import { byId, element, fitCanvas, onThemeChange, themeColour } from "../lib/dom";
import { PictureView } from "../lib/picture";
import { Drawing } from "../lib/drawing";
import { timed } from "../lib/parts";
import { latestOnly } from "../lib/signal";
import type { ProbeLight, State } from "../state";
import { reportError } from "./notices";

const THUMBNAIL_PX = 75;
const SLOWEST_STEP_S = 1; // of playing; longer pauses of a recording are shortened
const FASTEST_STEP_S = 0.05;

export function timelinePanel(api: Api, state: State): void {
  const scrub = byId<HTMLInputElement>("scrub");
  const thumbnails = new Thumbnails(api, state);
  const player = new Player(state);
  const chart = new Drawing(byId("timeline-chart"), "timeline", () => drawChart(state));

  const show = () => {
    const { history, entry } = state;
    const last = Math.max(0, history.value.length - 1);
    const at = state.shownEntry.value ?? last;
    scrub.max = String(last);
    scrub.value = String(at);
    scrub.disabled = last === 0;
    const none = state.picture.value ? "None kept since the server’s start" : "No frames yet";
    const text = entry ? `Frame ${entry.index} · ${entry.seconds.toFixed(1)} s` : none;
    scrub.setAttribute("aria-valuetext", text);
    byId("timeline-text").textContent = text;
    byId("go-live").setAttribute("aria-pressed", String(state.shownEntry.value === null));
    chart.request();
  };
  const loadPast = latestOnly(() => loadProbes(api, state));
  state.history.watch(() => {
    timed("timeline panel", show);
    thumbnails.update();
  });
  state.shownEntry.watch(() => {
    show();
    loadPast();
  });
  state.selected.watch(() => player.stop());
  state.picture.watch(() => state.entry ?? show());
  scrub.addEventListener("input", () => {
    player.stop();
    const at = Number(scrub.value);
    state.shownEntry.value = at === state.history.value.length - 1 ? null : at;
  });
  byId("go-live").addEventListener("click", () => {
    player.stop();
    state.shownEntry.value = null;
  });
  byId("play").addEventListener("click", () => player.toggle());
  const resized = () => {
    show();
    thumbnails.update();
  };
  new ResizeObserver(resized).observe(byId("thumbnails"));
  onThemeChange(show);
}

/** Plays the history at its own pace. */
class Player {
  private timer: ReturnType<typeof setTimeout> | null = null;

  constructor(private readonly state: State) {}

  toggle(): void {
    if (this.timer !== null) {
      return this.stop();
    }
    const { history, shownEntry } = this.state;
    if (history.value.length > 1) {
      const isAtEnd = shownEntry.value === null || shownEntry.value >= history.value.length - 1;
      this.show(isAtEnd ? 0 : shownEntry.value!);
    }
  }

  stop(): void {
    clearTimeout(this.timer ?? undefined);
    this.timer = null;
    this.showButton();
  }

  private show(at: number): void {
    const { history, shownEntry } = this.state;
    shownEntry.value = at;
    const [here, next] = [history.value[at], history.value[at + 1]];
    if (!here || !next) {
      shownEntry.value = null;
      return this.stop();
    }
    const step_s = Math.min(SLOWEST_STEP_S, Math.max(FASTEST_STEP_S, next.seconds - here.seconds));
    this.timer = setTimeout(() => this.show(at + 1), 1000 * step_s);
    this.showButton();
  }

  private showButton(): void {
    const button = byId("play");
    button.textContent = this.timer === null ? "Play" : "Pause";
    button.setAttribute("aria-pressed", String(this.timer !== null));
  }
}

/** As many thumbnails as fit, evenly from the history. */
class Thumbnails {
  private readonly pictures = new Map<HistoryEntry, HTMLCanvasElement>();
  readonly update = latestOnly(() => this.show());

  constructor(
    private readonly api: Api,
    private readonly state: State,
  ) {}

  private async show(): Promise<void> {
    const box = byId("thumbnails");
    const { history, selected } = this.state;
    const entries = history.value;
    const count = Math.min(entries.length, Math.floor(box.clientWidth / THUMBNAIL_PX));
    const shown = Array.from({ length: count }, (_, at) => entries[Math.floor(((at + 0.5) * entries.length) / count)]!);
    await Promise.all(shown.map((entry) => this.load(entry, selected.value!)));
    const pictures = shown.map((entry) => this.pictures.get(entry) ?? element("span"));
    if (pictures.some((picture, at) => picture !== box.children[at]) || pictures.length < box.children.length) {
      box.replaceChildren(...pictures);
    }
    [...this.pictures.keys()].filter((entry) => !shown.includes(entry)).forEach((entry) => this.pictures.delete(entry));
  }

  /** Decode a thumbnail before it is shown; one that cannot be read stays empty. */
  private async load(entry: HistoryEntry, session: string): Promise<void> {
    if (!this.pictures.has(entry)) {
      const canvas = element("canvas");
      try {
        const file = await this.api.file(`${sessionPath(session)}/history/${entry.index}/colour`);
        await new PictureView(canvas).show(file!.blob, String(entry.index));
        this.pictures.set(entry, canvas);
      } catch {
        return; // the history may have removed it meanwhile
      }
    }
  }
}

/** Load the light of the shown entry; live shows the newest light again. */
async function loadProbes(api: Api, state: State): Promise<void> {
  const [id, entry] = [state.selected.value, state.shownEntry.value === null ? null : state.entry];
  if (!id || !entry) {
    state.pastProbes.value = null;
    return;
  }
  try {
    const lights = await Promise.all(entry.probes.map((probe) => pastLight(api, id, entry.index, probe)));
    if (state.shownEntry.value !== null && state.selected.value === id) {
      state.pastProbes.value = new Map(lights.map((light) => [light.name, light]));
    }
  } catch (error) {
    reportError(error);
  }
}

async function pastLight(api: Api, id: string, index: number, probe: HistoryEntry["probes"][number]): Promise<ProbeLight> {
  const file = await api.file(`${sessionPath(id)}/history/${index}/probes/${encodeURIComponent(probe.name)}`);
  const panorama = parseHdr(new Uint8Array(await file!.blob.arrayBuffer()));
  return { ...probe, lights: probe.lights as ProbeLight["lights"], frame: index, panorama, seen: null, harmonics: null };
}

/** Columns of the time per frame; a mark above where frames were left out, red where refused; a line at the shown one. */
function drawChart(state: State): void {
  const { context, width, height } = fitCanvas(byId<HTMLCanvasElement>("timeline-chart"));
  const entries = state.history.value;
  const shown = state.shownEntry.value ?? entries.length - 1;
  const times_ms = entries.map(totalMs);
  const slowest_ms = times_ms.reduce((most, time) => Math.max(most, time), 1);
  const step = width / Math.max(1, entries.length);
  const top = 6;
  const [plain, accent, muted, bad] = ["--control-line", "--accent", "--muted", "--bad"].map(themeColour) as [string, string, string, string];
  const column = (at: number) => {
    const tall = ((height - top) * times_ms[at]!) / slowest_ms;
    context.fillRect(at * step, Math.round(height - tall), Math.max(1, step - 1), Math.round(tall));
  };
  context.globalAlpha = 0.5;
  context.fillStyle = plain;
  entries.forEach((_, at) => at !== shown && column(at));
  context.globalAlpha = 1;
  entries.forEach((entry, at) => {
    if (at > 0 && lostFrames(entry) > lostFrames(entries[at - 1]!)) {
      context.fillStyle = entry.refused > entries[at - 1]!.refused ? bad : muted;
      context.fillRect(at * step, 0, Math.max(2, step - 1), 3);
    }
  });
  if (entries[shown]) {
    context.fillStyle = accent;
    column(shown);
  }
}

/** Time of all stages of a frame. */
export function totalMs({ stage_ms }: HistoryEntry): number {
  return Object.values(stage_ms).reduce((sum, value) => sum + value, 0);
}

/** Frames up to this one that the light does not include. */
export function lostFrames({ superseded, gaps, skipped, refused }: HistoryEntry): number {
  return superseded + gaps + skipped + refused;
}
