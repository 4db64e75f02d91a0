// Short functions for the DOM.

/** The element with this id. Throws an Error if the page has none. */
export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) {
    throw new Error(`the page has no element #${id}`);
  }
  return element as T;
}

type Attributes = Readonly<Record<string, string | number | boolean | null | ((event: Event) => void)>>;

/** A new element. Attributes that are functions listen to the event of that name; false and null are left out. */
export function element<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") {
      made.addEventListener(name, value);
    } else if (value !== false && value !== null) {
      made.setAttribute(name, value === true ? "" : String(value));
    }
  }
  made.append(...children);
  return made;
}

const waiting = new WeakMap<HTMLElement, readonly Node[]>();

/**
 * Replace the children of a list; a button that had the focus, the one that stands for it now, or its neighbour has it again.
 *
 * While a button is pressed, the list waits: without the button there would be no click.
 */
export function replaceKeepingFocus(list: HTMLElement, children: readonly Node[]): void {
  waiting.set(list, children);
  if (list.matches(":active")) {
    requestAnimationFrame(() => waiting.get(list) === children && replaceKeepingFocus(list, children));
    return;
  }
  const nameOf = (button: Element) => button.getAttribute("data-name") ?? button.getAttribute("aria-label");
  const buttons = () => [...list.querySelectorAll("button")];
  const at = buttons().findIndex((button) => button === document.activeElement);
  const focused = buttons()[at];
  list.replaceChildren(...children);
  if (focused) {
    const now = buttons();
    const next = now.find((button) => nameOf(button) === nameOf(focused)) ?? now[Math.min(at, now.length - 1)];
    (next ?? byId("main")).focus();
  }
}

/** The value of a custom property of the page's theme, e.g. "--accent". */
export function themeColour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** Call `changed` when the system switches between light and dark. */
export function onThemeChange(changed: () => void): void {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
}

/** Clear a canvas and give it the resolution of the screen; returns its context, scaled to CSS pixels, and its size in them. */
export function fitCanvas(canvas: HTMLCanvasElement): { context: CanvasRenderingContext2D; width: number; height: number } {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = Math.min(devicePixelRatio, 2);
  const size = { width: Math.max(1, Math.round(width * ratio)), height: Math.max(1, Math.round(height * ratio)) };
  if (canvas.width !== size.width || canvas.height !== size.height) {
    Object.assign(canvas, size);
  }
  const context = canvas.getContext("2d")!;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}
