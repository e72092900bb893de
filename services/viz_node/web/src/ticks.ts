import { fixed } from "./numbers";

/** What an axis has room for; longer numbers have an exponent. */
const MOST_SIGNS = 7;
/** The room for a number beside an axis that goes up [px]. */
export const TICK_PX = 18;

/** Numbers beside an axis that differ as much as their places do: as many decimals as the step between them needs. */
export function tickTexts(values: readonly number[]): string[] {
  const steps = values.slice(1).map((value, i) => Math.abs(value - values[i]!)).filter((step) => step > 0);
  const step = Math.min(...steps, ...(steps.length ? [] : [Math.abs(values[0] ?? 1) || 1]));
  const decimals = decimalsOf(step);
  const texts = values.map((value) => short(fixed(value, decimals)));
  if (texts.every((text) => text.length <= MOST_SIGNS)) return texts;
  // with an exponent as many digits as tell neighbours apart
  const greatest = Math.max(...values.map(Math.abs));
  const digits = Math.min(8, Math.max(0, Math.floor(Math.log10(greatest / step) + 1e-9)));
  return values.map((value) => (value === 0 ? "0" : (+value.toExponential(digits)).toExponential()));
}

/** A number beside an axis by itself. */
export function tickText(value: number, digits = 3): string {
  const rounded = +value.toPrecision(digits) + 0;
  const text = `${rounded}`;
  return text.length > MOST_SIGNS ? rounded.toExponential() : text;
}

/** Places and texts of ticks between two numbers, at most so many of them, at 1, 2 or 5 times a power of ten. */
export function ticks(min: number, max: number, most = 4): [number, string][] {
  return withTexts(tickPlaces(min, max, most));
}

/** The places of such ticks alone. */
export function tickPlaces(min: number, max: number, most = 4): number[] {
  const rough = (max - min) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const steps = [0.2, 0.5, 1, 2, 5, 10].map((factor) => factor * power);
  const at = steps.findIndex((candidate, i) => i > 1 && candidate >= rough);
  // a single number beside an axis tells no scale, so the next finer step has its turn
  const places = placesOf(min, max, steps[at]!);
  return places.length > 1 ? places : placesOf(min, max, steps[at - 1]!);
}

/** All multiples of a step between two numbers. */
function placesOf(min: number, max: number, step: number): number[] {
  const places: number[] = [];
  for (let i = Math.ceil(min / step - 1e-9); i * step <= max + 1e-9 * step; i++) places.push(i * step + 0);
  return places;
}

function withTexts(places: number[]): [number, string][] {
  const texts = tickTexts(places);
  return places.map((place, i) => [place, texts[i]!]);
}

/** How many decimals a step has: 2.5 has one although it is larger than 1. */
function decimalsOf(step: number): number {
  let decimals = Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  while (decimals < 12 && Math.abs(step * 10 ** decimals - Math.round(step * 10 ** decimals)) > 1e-4) decimals++;
  return decimals;
}

/** A number with decimals that are all zero is written without them. */
function short(text: string): string {
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
}
