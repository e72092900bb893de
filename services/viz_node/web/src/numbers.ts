/** A force that no hand feels, as that of the read-out of a tip at rest, is shown as none [N]. */
const FELT_N = 0.015;

/** A number with so many digits behind its point; what rounds to none has no sign. */
export function fixed(value: number, digits: number): string {
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

/** A force at the hand [N]: hundredths, and 0.00 where nothing is felt. */
export function forceText(value: number): string {
  return Number.isNaN(value) ? "–" : fixed(Math.abs(value) < FELT_N ? 0 : value, 2);
}
