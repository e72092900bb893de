const MARGIN = 0.06;
/** How many standard deviations of the noise an automatic range shows at least, so that noise looks like noise. */
const NOISE_SHOWN = 12;

/** Standard deviation of the noise in values: from their second differences, which no slow motion has; by the median. */
export function noiseOf(values: ArrayLike<number | null | undefined>): number {
  const differences: number[] = [];
  for (let i = 2; i < values.length; i++) {
    const [a, b, c] = [values[i - 2], values[i - 1], values[i]];
    if (typeof a === "number" && typeof b === "number" && typeof c === "number") differences.push(Math.abs(a - 2 * b + c));
  }
  if (differences.length < 16) return 0;
  differences.sort((x, y) => x - y);
  // of a normal distribution the median is 0.6745 standard deviations, and a second difference has the square root of 6
  return differences[differences.length >> 1]! / (0.6745 * Math.sqrt(6));
}

/**
 * The range of an axis for values between two bounds: with a margin, and not smaller than the floor, which is the noise.
 * Where nothing is known it is that of the floor around 0.
 */
export function axisRange(min: number | null | undefined, max: number | null | undefined, floor: number, noise = 0): [number, number] {
  const least = Math.max(floor, NOISE_SHOWN * noise);
  if (min === null || max === null || min === undefined || max === undefined || !Number.isFinite(min) || !Number.isFinite(max)) return [-least / 2, least / 2];
  const span = Math.max(max - min, least);
  const middle = (min + max) / 2;
  const half = span * (0.5 + MARGIN);
  // what lies beside 0 within the floor is shown from 0 on
  if (max - min < least && Math.abs(middle) < least / 2) return [-half, half];
  return [middle - half, middle + half];
}

/** Whether values between two bounds are 0 but for what is less than the floor. */
export function isNothing(min: number | null | undefined, max: number | null | undefined, floor: number): boolean {
  return typeof min !== "number" || typeof max !== "number" || (Math.abs(min) < floor / 2 && Math.abs(max) < floor / 2);
}

/** An axis shrinks to a range that is smaller than this share of it, once that has been so for a while [ms]. */
const SHRINK = 0.6;
const SHRINK_MS = 4000;
/** Ends of an axis are at multiples of half a step of 1, 2 or 5, of which the range has about so many. */
const PARTS = 4;

/** An axis that holds still: its range, and since when it could be smaller [ms]. */
export interface HeldAxis {
  range: [number, number];
  smallerSince: number | undefined;
}

/** A range with its ends at round numbers, outwards. */
export function roundRange([low, high]: readonly [number, number]): [number, number] {
  const rough = (high - low) / PARTS;
  if (!(rough > 0)) return [low, high];
  const power = 10 ** Math.floor(Math.log10(rough) + 1e-9);
  const step = ([1, 2, 5, 10].find((factor) => factor * power >= rough * (1 - 1e-9)) ?? 10) * power * 0.5;
  const tidy = (value: number): number => +value.toPrecision(12) + 0;
  return [tidy(Math.floor(low / step + 1e-9) * step), tidy(Math.ceil(high / step - 1e-9) * step)];
}

/**
 * The axis that shows `wanted` and moves as little as it can: it grows at once, on the side alone where it has to, and
 * shrinks when it has been much too large for a while. `now` [ms]; `waits`: for how long [ms].
 */
export function heldAxis(before: HeldAxis | undefined, wanted: readonly [number, number], now: number, waits = SHRINK_MS): HeldAxis {
  const fitting = roundRange(wanted);
  if (!before) return { range: fitting, smallerSince: undefined };
  const [low, high] = before.range;
  const [isLow, isHigh] = [low <= wanted[0], high >= wanted[1]];
  if (!isLow || !isHigh) return { range: [isLow ? low : fitting[0], isHigh ? high : fitting[1]], smallerSince: undefined };
  if (fitting[1] - fitting[0] >= SHRINK * (high - low)) return { range: before.range, smallerSince: undefined };
  const since = before.smallerSince ?? now;
  return now - since >= waits ? { range: fitting, smallerSince: undefined } : { range: before.range, smallerSince: since };
}

/**
 * Least and greatest of points, two for each span of time, of the spans in which all of `holds` is 1; of all points where
 * there is no such span; undefined without points.
 */
export function extentOf(points: ArrayLike<number | null | undefined>, holds?: ArrayLike<number | null | undefined>): [number, number] | undefined {
  let all: [number, number] | undefined;
  let kept: [number, number] | undefined;
  const wider = (found: [number, number] | undefined, value: number): [number, number] => (found ? [Math.min(found[0], value), Math.max(found[1], value)] : [value, value]);
  for (let i = 0; i < points.length; i++) {
    const value = points[i];
    if (typeof value !== "number") continue;
    all = wider(all, value);
    const first = i - (i & 1);
    const span = [holds?.[first], holds?.[first + 1]].filter((each) => typeof each === "number");
    if (!holds || (span.length && span.every((each) => each >= 0.5))) kept = wider(kept, value);
  }
  return kept ?? all;
}
