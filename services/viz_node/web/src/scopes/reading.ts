import type { Ring } from "../ring";
import { mainFrequency } from "./spectrum";

/** Without samples for this long a curve is broken [s]. */
const GAPS: Record<string, number> = { link: 0.6, law_master: 0.2, law_slave: 0.2 };
const GAP = 0.06;

/** Where samples are read: those of a stream, and the time that two of them stand for, 0 where each is one [s]. */
export interface Samples {
  ring(stream: string): Ring | undefined;
  width: number;
}

/** What stands at a time: that of one sample, and of every column the value nearest to it. It stays as it was read. */
export interface Reading {
  time: number;
  /** Whether it was read among all samples, and not among the least and the greatest of spans. */
  isExact: boolean;
  values: ReadonlyMap<string, number>;
}

/** How far a column goes between two times, its mean, and how often it turns in a second; NaN where that is not known. */
export interface Stretch {
  peakToPeak: number;
  mean: number;
  hertz: number;
}

/** The time without samples from which on a stream is broken [s]. */
export function gapOf(stream: string): number {
  return GAPS[stream] ?? GAP;
}

/** Read every column of the streams at a time [s]; the time becomes that of the nearest sample of `of`. */
export function readAt(samples: Samples, columns: ReadonlyMap<string, readonly string[]>, time: number, of: string): Reading {
  const values = new Map<string, number>();
  for (const [stream, names] of columns) {
    const ring = samples.ring(stream);
    const within = Math.max(gapOf(stream), samples.width);
    names.forEach((name, column) => values.set(`${stream}.${name}`, ring ? sampleAt(ring, column, time, within)[1] : NaN));
  }
  const ring = samples.ring(of);
  const nearest = ring ? sampleAt(ring, undefined, time, Math.max(gapOf(of), samples.width))[0] : NaN;
  return { time: Number.isNaN(nearest) ? time : nearest, isExact: samples.width === 0, values };
}

/** Time and value of the sample nearest to a time, of those with a number where a column is given; NaN without any. */
export function sampleAt(ring: Ring, column: number | undefined, time: number, within: number): [time: number, value: number] {
  let [nearest, found, value] = [within, NaN, NaN];
  const middle = ring.indexAt(time);
  for (let i = Math.max(0, middle - 4); i < Math.min(ring.length, middle + 4); i++) {
    const away = Math.abs(ring.time(i) - time);
    const here = column === undefined ? 0 : ring.value(column, i);
    if (away <= nearest && !Number.isNaN(here)) [nearest, found, value] = [away, ring.time(i), here];
  }
  return [found, value];
}

/** The next sample of a ring after a time, or the one before it; that time itself where there is none [s]. */
export function neighbour(ring: Ring | undefined, time: number, direction: number): number {
  if (!ring?.length) return time;
  const at = direction > 0 ? ring.indexAt(time + 1e-6) : ring.indexAt(time - 1e-6) - 1;
  return at >= 0 && at < ring.length ? ring.time(at) : time;
}

/** Measure a column between two times [s]. Mean and frequency are those of all samples alone. */
export function measure({ ring: ringOf, width }: Samples, stream: string, column: number, from: number, to: number): Stretch {
  const [times, values] = samplesOf(ringOf(stream), column, from, to);
  if (!values.length) return { peakToPeak: NaN, mean: NaN, hertz: NaN };
  let [low, high, sum] = [Infinity, -Infinity, 0];
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
    sum += value;
  }
  const isWhole = width === 0;
  return { peakToPeak: high - low, mean: isWhole ? sum / values.length : NaN, hertz: isWhole ? mainFrequency(times, values) : NaN };
}

/** Times and values of the samples of a column between two times that have a number. */
export function samplesOf(ring: Ring | undefined, column: number, from: number, to: number): [times: number[], values: number[]] {
  const [times, values]: [number[], number[]] = [[], []];
  if (!ring || column < 0) return [times, values];
  for (let i = ring.indexAt(from); i < ring.length && ring.time(i) <= to; i++) {
    const value = ring.value(column, i);
    if (Number.isNaN(value)) continue;
    times.push(ring.time(i));
    values.push(value);
  }
  return [times, values];
}
