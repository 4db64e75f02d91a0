// Drawing that waits for the next frame of the screen, and that is left out while nobody sees the result.

import { timed } from "./parts";

/** Draws an element at most once a frame, and only while it is in the window. */
export class Drawing {
  private requested = false;
  private visible = true;
  private missed = false;
  private timer: ReturnType<typeof setTimeout> | null = null;

  /** `draw` gets the time of the frame, milliseconds. */
  constructor(
    element: Element,
    private readonly part: string,
    private readonly draw: (now_ms: number) => void,
  ) {
    new IntersectionObserver((entries) => this.see(entries.at(-1)!.isIntersecting)).observe(element);
  }

  /** Draw with the next frame of the screen. */
  readonly request = (): void => {
    this.cancelTimer();
    if (!this.visible) {
      this.missed = true;
    } else if (!this.requested) {
      this.requested = true;
      requestAnimationFrame((now_ms) => {
        this.requested = false;
        this.cancelTimer();
        timed(this.part, () => this.draw(now_ms));
      });
    }
  };

  /** Draw within `delay_ms`: changes of that time are drawn together. */
  requestWithin(delay_ms: number): void {
    if (!this.requested && this.timer === null) {
      this.timer = setTimeout(this.request, delay_ms);
    }
  }

  private cancelTimer(): void {
    clearTimeout(this.timer ?? undefined);
    this.timer = null;
  }

  private see(visible: boolean): void {
    this.visible = visible;
    if (visible && this.missed) {
      this.missed = false;
      this.request();
    }
  }
}
