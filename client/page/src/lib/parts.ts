// Time of the page's own work by part, for scripts/measure.mjs.

export interface PartTime {
  count: number;
  total_ms: number;
  longest_ms: number;
}

export const parts = new Map<string, PartTime>();

/** Do synchronous work and add its time to a part. */
export function timed<T>(part: string, work: () => T): T {
  const start = performance.now();
  try {
    return work();
  } finally {
    const took_ms = performance.now() - start;
    const sum = parts.get(part) ?? { count: 0, total_ms: 0, longest_ms: 0 };
    parts.set(part, {
      count: sum.count + 1,
      total_ms: sum.total_ms + took_ms,
      longest_ms: Math.max(sum.longest_ms, took_ms),
    });
  }
}
