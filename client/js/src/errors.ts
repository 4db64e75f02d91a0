import type { Problem } from "./wire.js";

/**
 * What the server refused, or that it could not be reached.
 *
 * status:   of HTTP; 0 when there was no answer.  problem: the server's own words (RFC 9457): field, value, rule.
 */
export class RoomLightError extends Error {
  override readonly name = "RoomLightError";

  constructor(
    message: string,
    readonly status: number,
    readonly problem: Problem | null = null,
    options?: ErrorOptions,
  ) {
    super(message, options);
  }

  static of(problem: Problem): RoomLightError {
    return new RoomLightError(`${problem.title}: ${problem.detail}`, problem.status, problem);
  }
}
