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
