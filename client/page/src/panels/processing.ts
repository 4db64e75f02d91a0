// Time of each stage of the shown frame, and the counts of frames.

import { byId, element } from "../lib/dom";
import type { HistoryEntry } from "../lib/answers";
import { timed } from "../lib/parts";
import type { State } from "../state";
import { totalMs } from "./timeline";

/** Names of the counts and what they mean. */
const COUNTS = [
  ["superseded", "Superseded", "A newer frame arrived first"],
  ["gaps", "Missing", "Indices that never arrived"],
  ["skipped", "Skipped", "Tracking was poor"],
  ["refused", "Refused", "Invalid frames"],
] as const;

export function processingPanel(state: State): void {
  const show = () => {
    const { entry, history } = state;
    const stages = Object.entries(entry?.stage_ms ?? {});
    const longest = Math.max(1, ...stages.map(([, ms]) => ms));
    byId("stages").replaceChildren(...stages.map(([name, ms]) => stage(name, ms, longest)));
    byId("speed-total").textContent = entry ? `${totalMs(entry).toFixed(0)} ms · ${rateText(history.value)}` : "";
    const processed = state.sessions.value?.find(({ id }) => id === state.selected.value)?.frames.processed;
    const counts = COUNTS.map(([key, label, meaning]) => count(label, entry?.[key] ?? 0, meaning, true));
    byId("counts").replaceChildren(count("Processed", processed ?? history.value.length, "In the light", false), ...counts);
  };
  state.history.watch(() => timed("processing panel", show));
  state.shownEntry.watch(show);
  state.sessions.watch(show);
}

function stage(name: string, ms: number, longest: number): HTMLLIElement {
  const fill = element("span", { class: "bar-fill" });
  fill.style.width = `${(100 * ms) / longest}%`;
  const track = element("span", { class: "bar-track", "aria-hidden": "true" }, fill);
  return element("li", {}, element("span", {}, name), track, element("span", { class: "value" }, `${ms.toFixed(1)} ms`));
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
