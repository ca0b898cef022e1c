// Amplitude spectrum of evenly spaced samples.

import FFT from "fft.js";

const FEWEST = 64; // samples of a spectrum
const BANDS = 80; // per decade of frequency

/** Samples in the order of their steps, each missed one the same as the one before it. */
export function fill(
  steps: ArrayLike<number>,
  values: ArrayLike<number>,
  most: number,
): Float64Array {
  let begin = steps.length - 1;
  if (begin < 0) return new Float64Array(0);
  const end = steps[begin]!;
  // only the run that goes on: it began where the steps went back
  while (begin > 0 && steps[begin - 1]! < steps[begin]! && end - steps[begin - 1]! < most) {
    begin -= 1;
  }
  const samples = new Float64Array(end - steps[begin]! + 1);
  let previous = 0;
  let at = 0;
  for (let i = begin; i < steps.length; i += 1) {
    const place = steps[i]! - steps[begin]!;
    while (at < place) samples[at++] = previous;
    previous = Number.isFinite(values[i]!) ? values[i]! : previous;
    samples[at++] = previous;
  }
  return samples;
}

/**
 * Amplitude over frequency [Hz], the mean removed, with a Hann window.
 *
 * A sine of amplitude A reads A at its frequency (up to 15 % less between two lines). Lines are
 * gathered into bands, the largest of each: a peak keeps its height.
 */
export function spectrum(samples: Float64Array, dt: number): { f: number[]; amplitude: number[] } {
  const n = samples.length;
  const [f, amplitude]: [number[], number[]] = [[], []];
  if (n < FEWEST || !(dt > 0)) return { f, amplitude };
  const mean = samples.reduce((sum, v) => sum + v / n, 0);
  const window = samples.map((_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * (i + 0.5)) / n));
  const size = 2 ** Math.ceil(Math.log2(n));
  const input = new Float64Array(size);
  input.set(samples.map((v, i) => (v - mean) * window[i]!));
  const fft = new FFT(size);
  const output = fft.createComplexArray();
  fft.realTransform(output, input);
  const scale = 2 / window.reduce((sum, w) => sum + w, 0);
  let band = NaN;
  for (let k = Math.max(1, Math.ceil(size / n)); k <= size / 2; k += 1) {
    const line = { f: k / (size * dt), a: scale * Math.hypot(output[2 * k], output[2 * k + 1]) };
    const last = f.length - 1;
    const lineBand = Math.floor(Math.log10(line.f) * BANDS);
    if (lineBand === band && line.a <= amplitude[last]!) continue;
    const at = lineBand === band ? last : last + 1;
    [f[at], amplitude[at], band] = [line.f, line.a, lineBand];
  }
  return { f, amplitude };
}
