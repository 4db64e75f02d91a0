// The light at the selected probe: panorama, exposure, false colour, coverage, main lights, and the probe's position.

import type { LightSourceValues, Position } from "roomlight";
import { byId, element, fitCanvas, onThemeChange, themeColour } from "../lib/dom";
import { Drawing } from "../lib/drawing";
import { timed } from "../lib/parts";
import { autoExposure, FALSE_COLOUR_STOPS, hueOf, luminance, toneMapped, turbo } from "../lib/tone";
import type { ProbeLight, State } from "../state";

const COMPASS_STEP = 45;
const SIDES = ["+x", "+x +z", "+z", "−x +z", "−x", "−x −z", "−z", "+x −z"] as const;

interface ProbeEvents {
  onMove: (name: string, position: Position) => void;
  onAdd: () => void;
  onRemove: (name: string) => void;
}

export function lightPanel(state: State, events: ProbeEvents): void {
  const canvas = byId<HTMLCanvasElement>("panorama-canvas");
  const { request: draw } = new Drawing(canvas, "panorama", () => drawPanorama(canvas, state));
  const select = byId<HTMLSelectElement>("probe-select");
  let isFirst = true;

  const show = () => {
    const { probe } = state;
    showChoices(select, [...state.probes.keys()], state.selectedProbe.value);
    byId("light-coverage").textContent = probe ? `${Math.round(100 * probe.coverage)} % seen` : "No probe";
    showPosition(probe, state.pastProbes.value !== null);
    byId("lights").replaceChildren(...(probe?.lights ?? []).map(lightRow));
    if (probe?.panorama && isFirst) {
      isFirst = false;
      state.exposureEv.value = Math.min(0, autoExposure(probe.panorama));
    }
    draw();
  };
  state.watchProbes(() => timed("light panel", show));
  state.selected.watch(() => (isFirst = true));
  state.falseColour.watch((on) => {
    byId("legend").hidden = !on;
    draw();
  });
  state.coverageTint.watch((on) => {
    byId<HTMLInputElement>("coverage-tint").checked = on;
    draw();
  });
  state.exposureEv.watch((ev) => {
    byId<HTMLInputElement>("exposure").value = String(ev);
    byId("exposure-value").textContent = `${ev > 0 ? "+" : ev < 0 ? "−" : ""}${Math.abs(ev)} EV`;
    draw();
  });
  new ResizeObserver(draw).observe(canvas);
  onThemeChange(draw);
  drawLegend();
  listen(state, select, events);
  canvas.addEventListener("pointermove", (event) => showReadout(event, canvas, state));
  canvas.addEventListener("pointerleave", () => (byId("panorama-readout").textContent = ""));
}

function listen(state: State, select: HTMLSelectElement, events: ProbeEvents): void {
  select.addEventListener("change", () => (state.selectedProbe.value = select.value));
  byId("exposure").addEventListener("input", ({ target }) => {
    state.exposureEv.value = Number((target as HTMLInputElement).value);
  });
  byId("exposure-auto").addEventListener("click", () => {
    const panorama = state.probe?.panorama;
    if (panorama) {
      state.exposureEv.value = autoExposure(panorama);
    }
  });
  for (const [id, signal] of [["false-colour", state.falseColour], ["coverage-tint", state.coverageTint]] as const) {
    byId(id).addEventListener("change", ({ target }) => (signal.value = (target as HTMLInputElement).checked));
  }
  const form = byId("probe-form");
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("change", ({ target }) => {
    const { id, valueAsNumber: value } = target as HTMLInputElement;
    const { probe } = state;
    if (probe && Number.isFinite(value)) {
      // the other fields are rounded
      events.onMove(probe.name, probe.position.map((old, at) => (id === `probe-${"xyz"[at]}` ? value : old)) as unknown as Position);
    }
  });
  byId("probe-add").addEventListener("click", () => events.onAdd());
  byId("probe-remove").addEventListener("click", () => state.selectedProbe.value && events.onRemove(state.selectedProbe.value));
}

function showChoices(select: HTMLSelectElement, names: readonly string[], selected: string | null): void {
  const shown = [...select.options].map(({ value }) => value);
  if (shown.join("\n") !== names.join("\n")) {
    select.replaceChildren(...names.map((name) => element("option", { value: name }, name)));
  }
  select.value = selected ?? "";
  select.disabled = names.length === 0;
}

function showPosition(probe: ProbeLight | null, isPast: boolean): void {
  ["x", "y", "z"].forEach((axis, at) => {
    const input = byId<HTMLInputElement>(`probe-${axis}`);
    input.disabled = probe === null || isPast;
    if (document.activeElement !== input) {
      input.value = probe ? probe.position[at]!.toFixed(2) : "";
    }
  });
  byId<HTMLButtonElement>("probe-remove").disabled = probe === null || isPast;
}

function drawPanorama(canvas: HTMLCanvasElement, state: State): void {
  const { context, width, height } = fitCanvas(canvas);
  const { probe } = state;
  const about = probe ? `${probe.name}, ${Math.round(100 * probe.coverage)} percent seen` : "no probe";
  canvas.setAttribute("aria-label", `Panorama of the light: ${about}`);
  if (!probe?.panorama || width === 0) {
    delete canvas.dataset["frame"];
    return;
  }
  canvas.dataset["frame"] = String(probe.frame);
  const isKnown = state.coverageTint.value && probe.seen?.length === probe.panorama.width * probe.panorama.height;
  const image = toneMapped(probe.panorama, {
    exposureEv: state.exposureEv.value,
    falseColour: state.falseColour.value,
    seen: isKnown ? probe.seen : null,
    tint: rgbOf(themeColour("--accent")),
  });
  const small = new OffscreenCanvas(image.width, image.height);
  small.getContext("2d")!.putImageData(image, 0, 0);
  context.imageSmoothingQuality = "high";
  context.drawImage(small, 0, 0, width, height);
  for (const light of probe.lights) {
    markLight(context, light, width, height);
  }
}

/** A ring where a main light is. */
function markLight(context: CanvasRenderingContext2D, { direction }: LightSourceValues, width: number, height: number): void {
  const { azimuth, elevation } = anglesOf(direction);
  const [x, y] = [(0.5 + azimuth / 360) * width, (0.5 - elevation / 180) * height];
  for (const [colour, line] of [["#000", 4], ["#fff", 2]] as const) {
    context.beginPath();
    context.arc(x, y, 9, 0, 2 * Math.PI);
    context.strokeStyle = colour;
    context.lineWidth = line;
    context.stroke();
  }
}

function drawLegend(): void {
  const context = byId<HTMLCanvasElement>("legend-canvas").getContext("2d")!;
  const image = context.createImageData(256, 1);
  for (let x = 0; x < 256; x++) {
    image.data.set([...turbo(x / 255), 255], 4 * x);
  }
  context.putImageData(image, 0, 0);
}

function showReadout(event: PointerEvent, canvas: HTMLCanvasElement, state: State): void {
  const panorama = state.probe?.panorama;
  if (panorama) {
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const column = Math.min(panorama.width - 1, Math.max(0, Math.floor(((event.clientX - left) / width) * panorama.width)));
    const row = Math.min(panorama.height - 1, Math.max(0, Math.floor(((event.clientY - top) / height) * panorama.height)));
    const [red, green, blue] = panorama.rgb.subarray(3 * (row * panorama.width + column)) as unknown as [number, number, number];
    const value = luminance(red, green, blue);
    const stops = value > 2 ** -FALSE_COLOUR_STOPS ? `, ${Math.log2(value).toFixed(1)} EV` : "";
    byId("panorama-readout").textContent = `RGB ${[red, green, blue].map((part) => part.toFixed(2)).join(" ")}${stops}`;
  }
}

function lightRow(light: LightSourceValues): HTMLTableRowElement {
  const swatch = element("span", { class: "swatch" });
  swatch.style.background = hueOf(light);
  const cells = [
    directionText(light.direction),
    light.intensity.map((value) => value.toFixed(value < 10 ? 2 : 1)).join("  "),
    `${Math.round(100 * light.shadow_strength)} %`,
  ];
  return element("tr", {}, element("td", {}, swatch), ...cells.map((text) => element("td", {}, text)));
}

function directionText(direction: LightSourceValues["direction"]): string {
  const { azimuth, elevation } = anglesOf(direction);
  if (elevation > 70) {
    return "above";
  }
  const side = SIDES[Math.round((azimuth + 360) / COMPASS_STEP) % 8]!;
  return `${side}, ${Math.round(elevation)}°`;
}

/** Degrees: azimuth from +x toward +z, elevation above the horizon. */
function anglesOf([x, y, z]: LightSourceValues["direction"]): { azimuth: number; elevation: number } {
  const degrees = 180 / Math.PI;
  return { azimuth: Math.atan2(z, x) * degrees, elevation: Math.asin(Math.min(1, Math.max(-1, y))) * degrees };
}

function rgbOf(hex: string): [number, number, number] {
  const value = Number.parseInt(hex.slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}
