// The resolution of the 3D view: lower while frames of the screen are late, full when nothing moves.

const LATE_MS = 25; // a frame of a screen of 60 Hz takes 16.7 ms
const AWAY_MS = 500; // the page was in the background
const LATE_FRAMES = 2; // lower the resolution after so many late frames
const GOOD_FRAMES = 60; // raise it after so many frames in time
const STEP = 0.8;
const LOWEST = 0.5; // of the screen's pixels, per axis
const SOFTWARE = 0.6; // without a graphics processor, where each change waits for all drawings before it
const REST_MS = 400; // without a drawing of a movement

/** Finds the factor of the resolution, LOWEST to 1, from the time between frames of the screen. */
export class Resolution {
  private moving: number;
  private late = 0;
  private good = 0;
  private watching = false;
  private timer: ReturnType<typeof setTimeout> | null = null;

  /**
   * `redraw` is called when a view of lower resolution is at rest: its next drawing has the full one.
   * Without a graphics processor (`isSoftware`) the factor of movements is fixed.
   */
  constructor(
    private readonly redraw: () => void,
    private readonly isSoftware: boolean,
  ) {
    this.moving = isSoftware ? SOFTWARE : 1;
  }

  /** The factor for a drawing in the frame of this time, milliseconds; `moves`: it shows what the visitor moves. */
  next(now_ms: number, moves: boolean): number {
    if (moves && this.moving < 1) {
      clearTimeout(this.timer ?? undefined);
      this.timer = setTimeout(() => {
        this.timer = null;
        this.redraw();
      }, REST_MS);
    }
    if (!this.watching && !this.isSoftware) {
      this.watch(now_ms, 2); // a busy graphics processor delays the second frame after a drawing
    }
    return moves || this.timer !== null ? this.moving : 1;
  }

  private watch(last_ms: number, frames: number): void {
    this.watching = true;
    requestAnimationFrame((now_ms) => {
      this.judge(now_ms - last_ms);
      if (frames > 1) {
        this.watch(now_ms, frames - 1);
      } else {
        this.watching = false;
      }
    });
  }

  private judge(gap_ms: number): void {
    if (gap_ms > AWAY_MS) {
      return;
    }
    const isLate = gap_ms > LATE_MS;
    this.late = isLate ? this.late + 1 : 0;
    this.good = isLate ? 0 : this.good + 1;
    if (this.late >= LATE_FRAMES) {
      this.late = 0;
      this.moving = Math.max(LOWEST, this.moving * STEP);
    } else if (this.good >= GOOD_FRAMES) {
      this.good = 0;
      this.moving = Math.min(1, this.moving / STEP);
    }
  }
}
