// How the client waits between attempts. Not part of the package's interface: its own tests replace these functions.

export const waiting = {
  /** The random part of a delay, from 0 to 1. */
  random: (): number => Math.random(),

  /** Resolve after some seconds; reject with the signal's reason once it is aborted. */
  delay: (seconds: number, signal: AbortSignal | undefined): Promise<void> =>
    new Promise((resolve, reject) => {
      signal?.throwIfAborted();
      const stop = () => {
        clearTimeout(timer);
        reject(signal?.reason);
      };
      const timer = setTimeout(() => {
        signal?.removeEventListener("abort", stop);
        resolve();
      }, seconds * 1000);
      signal?.addEventListener("abort", stop, { once: true });
    }),

  /** The promise's outcome; reject with the signal's reason if it is aborted before. */
  untilAborted: <T>(promise: Promise<T>, signal: AbortSignal | undefined): Promise<T> =>
    new Promise((resolve, reject) => {
      const stop = () => reject(signal?.reason);
      if (signal?.aborted) {
        stop();
      }
      signal?.addEventListener("abort", stop, { once: true });
      void promise.then(resolve, reject).finally(() => signal?.removeEventListener("abort", stop));
    }),
};
