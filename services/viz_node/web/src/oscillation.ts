/** A motion that goes to and fro: how often in a second, and how far from peak to peak. */
export interface Oscillation {
  hertz: number;
  peakToPeak: number;
}

/** Whole turns that a motion has to have made before it is called one that swings. */
const LEAST_TURNS = 4;
/** A crossing of the mean counts when the values have been this share of the whole away from it on either side. */
const HYSTERESIS = 0.12;
/** Turns of one oscillation are within this factor of their median, but for a few: a hand that works is not so even. */
const EVENNESS = 1.5;
const EVEN_SHARE = 0.75;

/**
 * Find an oscillation in values at times [s]: at least four turns of about the same length around their mean, and
 * at least `least` from peak to peak. Returns undefined where there is none.
 */
export function oscillationIn(times: ArrayLike<number>, values: ArrayLike<number>, least: number): Oscillation | undefined {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < values.length; i++) {
    const value = values[i]!;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  const whole = high - low;
  if (!(whole >= least)) return undefined;
  let mean = 0;
  for (let i = 0; i < values.length; i++) mean += values[i]! / values.length;
  const [upper, lower] = [mean + whole * HYSTERESIS, mean - whole * HYSTERESIS];
  const rises: number[] = [];
  let isHigh: boolean | undefined;
  for (let i = 0; i < values.length; i++) {
    const value = values[i]!;
    if (value > upper && isHigh !== true) {
      if (isHigh === false) rises.push(times[i]!);
      isHigh = true;
    } else if (value < lower) isHigh = false;
  }
  if (rises.length <= LEAST_TURNS) return undefined;
  const turns = rises.slice(1).map((time, i) => time - rises[i]!);
  const median = [...turns].sort((a, b) => a - b)[turns.length >> 1]!;
  const even = turns.filter((turn) => turn < EVENNESS * median && turn > median / EVENNESS);
  if (even.length < Math.max(LEAST_TURNS, EVEN_SHARE * turns.length)) return undefined;
  // what has come to rest since then swings no more
  const end = times[times.length - 1]!;
  if (end - rises.at(-1)! > 2 * median) return undefined;
  return { hertz: 1 / median, peakToPeak: whole };
}
