/** What the margin left of an axis has room for. */
const MOST_SIGNS = 7;

/** A number beside an axis: with an exponent where it would not fit otherwise. */
export function tickText(value: number, digits = 3): string {
  const rounded = +value.toPrecision(digits) + 0;
  const text = `${rounded}`;
  return text.length > MOST_SIGNS ? rounded.toExponential() : text;
}

/** Places and texts of ticks between two numbers, about four of them, at 1, 2 or 5 times a power of ten. */
export function ticks(min: number, max: number): [number, string][] {
  const rough = (max - min) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough) ?? rough;
  const found: [number, string][] = [];
  for (let i = Math.ceil(min / step); i * step <= max; i++) found.push([i * step, tickText(i * step)]);
  return found;
}
