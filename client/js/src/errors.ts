import type { Problem } from "./wire.js";

/**
 * The server refused a request, or did not respond.
 *
 * status:  of HTTP; 0 without a response.
 * problem: the server's problem details (RFC 9457); null where the response has none.
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

  /** The error of a problem; its message has the problem's field, rule and value. */
  static fromProblem(problem: Problem): RoomLightError {
    const { title, status, detail, field, value, rule } = problem;
    const parts = [`${title}: ${detail}`];
    if (rule && !detail.includes(rule)) {
      parts.push(field ? `${field}: ${rule}` : rule);
    }
    if (value && !detail.includes(value)) {
      parts.push(`got ${value}`);
    }
    return new RoomLightError(parts.join("; "), status, problem);
  }

  /** The last part of the problem's type, e.g. `session-conflict`; "" without a problem. */
  get kind(): string {
    return this.problem?.type?.split(":").at(-1) ?? "";
  }

  /** The field that is wrong, for a `session-conflict` the option that differs; "" where the problem names none. */
  get field(): string {
    return this.problem?.field ?? "";
  }

  /** What the field contained. */
  get value(): string {
    return this.problem?.value ?? "";
  }

  /** What the server accepts there. */
  get rule(): string {
    return this.problem?.rule ?? "";
  }
}
