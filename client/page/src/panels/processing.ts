// Time of each stage of the shown frame, and the counts of frames.

import type { HistoryEntry } from "roomlight";
import { byId, element } from "../lib/dom";
import { timed } from "../lib/parts";
import type { State } from "../state";
import { totalMs } from "./timeline";

/** Names of the counts and what they mean. */
const COUNTS = [
  ["superseded", "Superseded", "A newer frame arrived before this one was processed: harmless, the light has the newer one"],
  ["gaps", "Missing", "Indices that were not sent, because the sender leaves frames out to keep up: harmless"],
  ["skipped", "Skipped", "The camera's tracking was poor"],
  ["refused", "Refused", "The server refused these frames: the sender has the reason"],
] as const;
const STAGES: Readonly<Record<string, string>> = {
  prepare: "Reduce the frame, complete its depth, estimate its clipped light",
  volume: "Project the frame into a volume around the camera",
  sglv: "The networks turn the volume into light: the spherical Gaussian lighting volume",
  mesh: "Connect the depth to a mesh",
  keyframes: "Keep the frame for points that are requested later",
  render: "Ray trace the volume at each probe",
  partial: "What each probe sees of the mesh",
  blend: "Blend both into each probe's panorama",
  lights: "Find the main lights",
};

export function processingPanel(state: State): void {
  const show = () => {
    const { entry, history, frames } = state;
    const stages = Object.entries(entry?.stage_ms ?? {});
    const longest = Math.max(1, ...stages.map(([, ms]) => ms));
    byId("stages").replaceChildren(...stages.map(([name, ms]) => stage(name, ms, longest)));
    byId("speed-total").textContent = entry ? `${totalMs(entry).toFixed(0)} ms · ${rateText(history.value)}` : "";
    const counts = COUNTS.map(([key, label, meaning]) => count(label, entry?.[key] ?? frames?.[key] ?? 0, meaning, key === "refused"));
    byId("counts").replaceChildren(count("Processed", frames?.processed ?? history.value.length, "In the light", false), ...counts);
  };
  state.history.watch(() => timed("processing panel", show));
  state.shownEntry.watch(show);
  state.sessions.watch(show);
}

function stage(name: string, ms: number, longest: number): HTMLLIElement {
  const fill = element("span", { class: "bar-fill" });
  fill.style.width = `${(100 * ms) / longest}%`;
  const track = element("span", { class: "bar-track", "aria-hidden": "true" }, fill);
  return element("li", { title: STAGES[name] ?? null }, element("span", {}, name), track, element("span", { class: "value" }, `${ms.toFixed(1)} ms`));
}

function count(label: string, value: number, meaning: string, isLoss: boolean): HTMLDivElement {
  const attributes = { class: isLoss && value > 0 ? "warn" : null, title: meaning };
  return element("div", attributes, element("dt", {}, label), element("dd", {}, String(value)));
}

/** Processed frames per second over the last ten. */
function rateText(entries: readonly HistoryEntry[]): string {
  const recent = entries.slice(-10);
  const span_s = (recent.at(-1)?.seconds ?? 0) - (recent[0]?.seconds ?? 0);
  return span_s > 0 ? `${((recent.length - 1) / span_s).toFixed(1)} frames/s` : "";
}
