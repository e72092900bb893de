/** A motion that goes to and fro: how often in a second, and how far from peak to peak. */
export interface Oscillation {
  hertz: number;
  peakToPeak: number;
}

/** Whole turns, to and fro, that a motion has to have made before it is called one that swings. */
const TURNS = 3;
/** A turn takes at most this many times as long as the one before: a hand that works is not so even. */
const EVENNESS = 1.5;
/** Of the ways of a turn none is this many times another: a press is no part of the swing that follows it. */
const LIKENESS = 4;
/** What has not turned evenly for this many turns swings no more. */
const STILL_TURNS = 2;

/**
 * Find an oscillation that goes on at the end of values at times [s]: three turns, each about as long as the one
 * before, of at least `least` from peak to peak. Returns undefined where there is none.
 *
 * `telenano/analysis/swings.py` finds them in a recording by the same rule, and `test/swings.json` holds both to it.
 */
export function oscillationIn(times: ArrayLike<number>, given: ArrayLike<number>, least: number): Oscillation | undefined {
  const values = middleOfThree(given);
  const end = times[times.length - 1] ?? NaN;
  let found: Oscillation | undefined;
  let places = turningPoints(values, Array.from(values, (_, i) => i), least);
  // of a ripple on a large swing, or a small swing after a large step, each shows at its own height
  for (let height = least; places.length > 2 * TURNS + 1; places = turningPoints(values, places, (height *= 2))) {
    const run = lastEvenRun(times, values, places);
    if (!run || end - times[places[run.to]!]! > STILL_TURNS * run.turn) continue;
    const [a, b, c] = [2, 1, 0].map((back) => values[places[run.to - back]!]!) as [number, number, number];
    found = { hertz: 1 / run.turn, peakToPeak: Math.max(Math.abs(b - a), Math.abs(c - b)) };
  }
  return found;
}

/** Of each three values in a row the middle one: a sample alone, as where an answer is missing, does not count. */
function middleOfThree(values: ArrayLike<number>): Float64Array {
  return Float64Array.from(values, (now, i) => {
    const [before, after] = [values[i - 1] ?? now, values[i + 1] ?? now];
    return Math.max(Math.min(before, now), Math.min(Math.max(before, now), after));
  });
}

/** The places, of those given, from which a motion comes back by a height, and that at which it begins. */
function turningPoints(values: ArrayLike<number>, places: readonly number[], height: number): number[] {
  const found: number[] = [];
  let rises: boolean | undefined;
  let [low, high] = [places[0] ?? 0, places[0] ?? 0];
  for (const i of places) {
    const now = values[i]!;
    if (now >= values[high]!) high = i;
    if (now <= values[low]!) low = i;
    if (rises !== false && now <= values[high]! - height) {
      found.push(high);
      [rises, low] = [false, i];
    } else if (rises !== true && now >= values[low]! + height) {
      found.push(low);
      [rises, high] = [true, i];
    }
  }
  return found;
}

/** The last run of turning points of which each whole turn takes about as long as the one before. */
function lastEvenRun(times: ArrayLike<number>, values: ArrayLike<number>, places: readonly number[]): { to: number; turn: number } | undefined {
  // a turn is timed in the middle of its ways, where the force goes fast
  const middles = places.slice(1).map((last, i) => times[crossing(values, places[i]!, last)]!);
  const turns = middles.slice(2).map((time, i) => time - middles[i]!);
  const ways = places.slice(1).map((last, i) => Math.abs(values[last]! - values[places[i]!]!));
  const isAlike = (i: number): boolean => Math.max(...ways.slice(i, i + 3)) <= LIKENESS * Math.min(...ways.slice(i, i + 3));
  const isEven = (i: number): boolean => turns[i]! <= EVENNESS * turns[i - 1]! && turns[i]! >= turns[i - 1]! / EVENNESS && isAlike(i) && isAlike(i - 1);
  for (let last = turns.length - 1; last >= 0; ) {
    let first = last;
    while (first > 0 && isEven(first)) first--;
    // the turns first .. last lie between the points first .. last + 3
    if (last + 3 - first > 2 * TURNS) return { to: last + 3, turn: median(turns.slice(first, last + 1)) };
    last = first - 1;
  }
  return undefined;
}

/** The first place between two turning points at which half of the way is behind. */
function crossing(values: ArrayLike<number>, first: number, last: number): number {
  const middle = (values[first]! + values[last]!) / 2;
  const sign = values[last]! > values[first]! ? 1 : -1;
  for (let i = first; i < last; i++) if (sign * (values[i]! - middle) >= 0) return i;
  return last;
}

function median(values: readonly number[]): number {
  const sorted = [...values].sort((a, b) => a - b);
  const middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle]! : (sorted[middle - 1]! + sorted[middle]!) / 2;
}
