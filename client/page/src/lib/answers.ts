// Answers of the endpoints that only the page uses. Positions in world metres, y up; matrices column by column.

import type { CompositeObject, FrameCounts, LightSourceValues, Position, Problem, WireIntrinsics } from "roomlight";

/** What is kept with a session for everyone who looks at it. Fields without a value may be null. */
export interface SessionScene {
  readonly title: string;
  readonly objects: readonly CompositeObject[];
}

/** A scene as it was read. */
export interface KeptScene extends SessionScene {
  readonly etag: string;
}

export interface SessionSummary {
  readonly id: string;
  /** As its viewers have named it; empty: they have not. */
  readonly title: string;
  readonly status: "open" | "failed";
  readonly model: string;
  readonly frames: FrameCounts;
  readonly probes: readonly string[];
  readonly keyframes: number;
  readonly idle_s: number;
}

export interface SessionList {
  readonly sessions: readonly SessionSummary[];
  readonly max_sessions: number;
  readonly idle_expiry_s: number;
}

export interface CameraState {
  readonly frame: number;
  readonly intrinsics: WireIntrinsics | null;
  readonly camera_to_world: readonly number[] | null;
  readonly path: readonly { readonly index: number; readonly seconds: number; readonly camera_to_world: readonly number[] }[];
  readonly volume: {
    readonly volume_to_world: readonly number[];
    readonly lower_m: Position;
    readonly upper_m: Position;
  } | null;
}

export interface HistoryProbe {
  readonly name: string;
  readonly position: Position;
  readonly coverage: number;
  readonly lights: readonly LightSourceValues[];
}

/** A processed frame. Counts are totals of the session so far. */
export interface HistoryEntry {
  readonly index: number;
  readonly seconds: number;
  readonly keyframe: boolean;
  readonly stage_ms: { readonly [stage: string]: number };
  readonly superseded: number;
  readonly gaps: number;
  readonly skipped: number;
  readonly refused: number;
  readonly probes: readonly HistoryProbe[];
}

export interface History {
  readonly stride: number;
  readonly limit_bytes: number;
  readonly entries: readonly HistoryEntry[];
}

export interface Film {
  readonly status: "reading" | "making" | "ready" | "failed";
  /** Frames that are read for the light, or made. */
  readonly frame: number;
  readonly frames: number;
  readonly problem: Problem | null;
}

export interface Recording {
  readonly id: string;
  readonly name: string;
  readonly bytes: number;
  readonly received: number;
  readonly status: "uploading" | "ready" | "playing" | "finished" | "failed";
  readonly session: string | null;
  readonly frame: number;
  readonly frames: number | null;
  readonly unreadable: number;
  /** What its files state and was left out, guessed or changed, and what to do about it. */
  readonly notes: readonly string[];
  /** Frames that a film of it can have, and their rate; null until the server has opened it. */
  readonly film_frames: number | null;
  readonly film_fps: number | null;
  readonly film: Film | null;
  readonly problem: Problem | null;
}

export interface RecordingList {
  readonly recordings: readonly Recording[];
  readonly bytes: number;
  readonly limit_bytes: number;
}

export interface FilmRequest {
  readonly objects: readonly CompositeObject[];
  readonly quality: "preview" | "good" | "final";
  readonly first: number;
  readonly frames: number;
}

export interface Pairing {
  readonly url: string | null;
  readonly qr_svg: string | null;
  readonly fingerprint: string | null;
  readonly expires_in_s: number | null;
  readonly advice: string | null;
}

export interface PairedPhone {
  readonly id: string;
  readonly age_s: number;
  readonly expires_in_s: number;
  readonly sessions: readonly string[];
}
