// What the page shows, in signals that the panels watch.

import type { CameraView, HistoryEntry, LightSourceValues, Panorama, Position, SessionSummary } from "roomlight";
import { Signal } from "./lib/signal";

export type ConnectionState = "connecting" | "live" | "reconnecting" | "disconnected";

export interface Connection {
  readonly state: ConnectionState;
  readonly text: string;
}

/** The end of a session for the page. */
export interface Ending {
  readonly title: string;
  readonly text: string;
}

/** The light at one probe: of the newest frame, or of an earlier one on the timeline. */
export interface ProbeLight {
  readonly name: string;
  /** Index of the newest frame in this light; -1 before the first. */
  readonly frame: number;
  readonly position: Position;
  readonly coverage: number;
  /** Null until it has arrived. */
  readonly panorama: Panorama | null;
  /** For each pixel of the panorama, 255 where a frame has seen it and 0 where it is inferred; null if unknown. */
  readonly seen: Uint8ClampedArray | null;
  readonly lights: readonly LightSourceValues[];
  /** Nine RGB coefficients with the signs of three.js; null if unknown. */
  readonly harmonics: readonly number[] | null;
}

/** The newest frame's picture. */
export interface Picture {
  readonly blob: Blob;
  readonly frame: number;
}

export class State {
  readonly connection = new Signal<Connection>({ state: "connecting", text: "Connecting" });
  /** Null before the first answer. */
  readonly sessions = new Signal<readonly SessionSummary[] | null>(null);
  readonly selected = new Signal<string | null>(null);
  /** Why the selected session is not shown; null while it is. */
  readonly ended = new Signal<Ending | null>(null);

  readonly camera = new Signal<CameraView | null>(null);
  readonly picture = new Signal<Picture | null>(null);
  /** Triangles that the 3D view can draw. */
  readonly meshTriangles = new Signal(60_000);
  readonly mesh = new Signal<ArrayBuffer | null>(null);
  readonly history = new Signal<readonly HistoryEntry[]>([]);
  /** Position in `history` that is shown; null: live. */
  readonly shownEntry = new Signal<number | null>(null);

  /** Light of the newest frame by probe. */
  readonly liveProbes = new Signal<ReadonlyMap<string, ProbeLight>>(new Map());
  /** Light of the shown entry of the timeline; null: live. */
  readonly pastProbes = new Signal<ReadonlyMap<string, ProbeLight> | null>(null);
  readonly selectedProbe = new Signal<string | null>(null);
  /** The probe that the page's address names: selected when its light arrives. */
  wantedProbe: string | null = null;

  readonly exposureEv = new Signal(0);
  readonly falseColour = new Signal(false);
  readonly coverageTint = new Signal(false);

  /** The probes that are shown now. */
  get probes(): ReadonlyMap<string, ProbeLight> {
    return this.pastProbes.value ?? this.liveProbes.value;
  }

  /** The selected probe's light, if there is any. */
  get probe(): ProbeLight | null {
    return this.probes.get(this.selectedProbe.value ?? "") ?? null;
  }

  /** Call `listener` now and when the shown light or its selection changes. */
  watchProbes(listener: () => void): void {
    this.liveProbes.watch(listener);
    this.pastProbes.watch(listener);
    this.selectedProbe.watch(listener);
  }

  /** The shown entry of the timeline, the last one while it is live. */
  get entry(): HistoryEntry | null {
    return this.history.value.at(this.shownEntry.value ?? -1) ?? null;
  }

  /** The counts of the selected session's frames; they outlive a restart of the server, the history does not. */
  get frames(): SessionSummary["frames"] | null {
    return this.sessions.value?.find(({ id }) => id === this.selected.value)?.frames ?? null;
  }

  /** Forget everything of a session. */
  clearSession(): void {
    this.camera.value = null;
    this.picture.value = null;
    this.mesh.value = null;
    this.history.value = [];
    this.shownEntry.value = null;
    this.liveProbes.value = new Map();
    this.pastProbes.value = null;
    this.selectedProbe.value = null;
  }
}
