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
