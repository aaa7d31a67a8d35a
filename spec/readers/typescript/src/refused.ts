/** What is there cannot be read: the message says what, where, and what to do. */
export class Refused extends Error {}

/** Refuse unless a condition holds. */
export function demand(condition: boolean, message: string): asserts condition {
  if (!condition) throw new Refused(message);
}
