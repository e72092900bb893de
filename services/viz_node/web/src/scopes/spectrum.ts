/** Frequencies [Hz] and amplitudes of a signal that was sampled evenly. */
export interface Spectrum {
  hertz: number[];
  amplitude: number[];
}

/**
 * Amplitude spectrum of values sampled `rate` times a second: the mean taken off, a Hann window, and so scaled that a
 * sine of amplitude a on a line of the spectrum has the value a there. As many values as the next lower power of two.
 */
export function spectrumOf(values: ArrayLike<number>, rate: number): Spectrum {
  const count = 2 ** Math.floor(Math.log2(Math.max(1, values.length)));
  if (count < 8) return { hertz: [], amplitude: [] };
  const from = values.length - count;
  let mean = 0;
  for (let i = 0; i < count; i++) mean += values[from + i]! / count;
  const real = new Float64Array(count);
  const imaginary = new Float64Array(count);
  for (let i = 0; i < count; i++) real[i] = (values[from + i]! - mean) * (0.5 - 0.5 * Math.cos((2 * Math.PI * i) / count));
  transform(real, imaginary);
  // the window has a mean of one half, and half of a sine is at the negative frequency
  const scale = 4 / count;
  const lines = Array.from({ length: count / 2 - 1 }, (_, i) => i + 1);
  return { hertz: lines.map((i) => (i * rate) / count), amplitude: lines.map((i) => Math.hypot(real[i]!, imaginary[i]!) * scale) };
}

/** Cycles that values have to have before a frequency is told of them, and samples and padding of its transform. */
const LEAST_CYCLES = 2;
const SAMPLES = 2048;
const PADDING = 4;
/** A line stands out that is this many times as high as most. */
const STANDS_OUT = 5;

/**
 * The frequency at which values at times [s] go to and fro most [Hz], of at least two cycles; NaN where none stands out.
 * Their trend is taken off, and the frequency lies where a parabola through the highest line and its neighbours has its
 * top, which is a hundredth of a line beside a sine.
 */
export function mainFrequency(times: ArrayLike<number>, values: ArrayLike<number>): number {
  const count = times.length;
  const length = count > 1 ? times[count - 1]! - times[0]! : 0;
  if (count < 16 || !(length > 0)) return NaN;
  const even = resampled(times, values, times[0]!, times[0]! + length, SAMPLES);
  const slope = trendOf(even);
  let mean = 0;
  for (const value of even) mean += value / SAMPLES;
  const real = new Float64Array(SAMPLES * PADDING);
  const imaginary = new Float64Array(SAMPLES * PADDING);
  for (let i = 0; i < SAMPLES; i++) real[i] = (even[i]! - mean - slope * (i - (SAMPLES - 1) / 2)) * (0.5 - 0.5 * Math.cos((2 * Math.PI * i) / SAMPLES));
  transform(real, imaginary);
  const lines = Float64Array.from({ length: (SAMPLES * PADDING) / 2 }, (_, i) => Math.hypot(real[i]!, imaginary[i]!));
  // what is above half of the rate of the samples is made by holding each to the next
  const last = Math.min(lines.length - 2, Math.floor((PADDING * count) / 2));
  let top = Math.round(LEAST_CYCLES * PADDING * 0.9);
  for (let i = top; i <= last; i++) if (lines[i]! > lines[top]!) top = i;
  const sorted = [...lines.slice(0, last)].sort((a, b) => a - b);
  const isPeak = lines[top]! > lines[top - 1]! && lines[top]! > lines[top + 1]!;
  if (!isPeak || lines[top]! < STANDS_OUT * (sorted[sorted.length >> 1] ?? 0)) return NaN;
  const [a, b, c] = [top - 1, top, top + 1].map((i) => Math.log(lines[i]! || 1e-300)) as [number, number, number];
  const place = top + (0.5 * (a - c)) / (a - 2 * b + c || 1);
  return place / PADDING / length;
}

/** Slope of the straight line through values at even places. */
function trendOf(values: ArrayLike<number>): number {
  const middle = (values.length - 1) / 2;
  let [sum, squares] = [0, 0];
  for (let i = 0; i < values.length; i++) {
    sum += (i - middle) * values[i]!;
    squares += (i - middle) ** 2;
  }
  return squares > 0 ? sum / squares : 0;
}

/** The discrete Fourier transform in place, after Cooley and Tukey; the length is a power of two. */
function transform(real: Float64Array, imaginary: Float64Array): void {
  const count = real.length;
  for (let i = 1, j = 0; i < count; i++) {
    let bit = count >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) {
      [real[i], real[j]] = [real[j]!, real[i]!];
      [imaginary[i], imaginary[j]] = [imaginary[j]!, imaginary[i]!];
    }
  }
  for (let size = 2; size <= count; size <<= 1) {
    const half = size >> 1;
    const angle = (-2 * Math.PI) / size;
    for (let k = 0; k < half; k++) {
      const [c, s] = [Math.cos(angle * k), Math.sin(angle * k)];
      for (let i = k; i < count; i += size) {
        const [re, im] = [real[i + half]! * c - imaginary[i + half]! * s, real[i + half]! * s + imaginary[i + half]! * c];
        [real[i + half], imaginary[i + half]] = [real[i]! - re, imaginary[i]! - im];
        [real[i], imaginary[i]] = [real[i]! + re, imaginary[i]! + im];
      }
    }
  }
}

/** Values at even times [s] from samples at any times in rising order: each the newest sample before it. */
export function resampled(times: ArrayLike<number>, values: ArrayLike<number>, from: number, to: number, count: number): Float64Array {
  const found = new Float64Array(count);
  let j = 0;
  for (let i = 0; i < count; i++) {
    const at = from + ((to - from) * i) / count;
    while (j + 1 < times.length && times[j + 1]! <= at) j++;
    found[i] = values[j] ?? 0;
  }
  return found;
}
