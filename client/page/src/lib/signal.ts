// A value that tells its listeners when it changes. Listeners of one turn of the event loop are called once.

export class Signal<T> {
  private readonly listeners = new Set<(value: T) => void>();
  private scheduled = false;

  constructor(private current: T) {}

  get value(): T {
    return this.current;
  }

  set value(next: T) {
    if (!Object.is(next, this.current)) {
      this.current = next;
      this.changed();
    }
  }

  /** Tell the listeners that the value was changed in place. */
  changed(): void {
    if (!this.scheduled) {
      this.scheduled = true;
      queueMicrotask(() => {
        this.scheduled = false;
        this.listeners.forEach((listener) => listener(this.current));
      });
    }
  }

  /** Call `listener` now and after each change. */
  watch(listener: (value: T) => void): void {
    this.listeners.add(listener);
    listener(this.current);
  }
}

/** Call `work` again only when the last call is done, with the newest request: at most one waits. */
export function latestOnly(work: () => Promise<void>, pause_ms = 0): () => void {
  let running = false;
  let again = false;
  const run = async () => {
    if (running) {
      again = true;
      return;
    }
    running = true;
    try {
      do {
        again = false;
        await work();
        if (pause_ms > 0) {
          await new Promise((resolve) => setTimeout(resolve, pause_ms));
        }
      } while (again);
    } finally {
      running = false;
    }
  };
  return () => void run();
}
