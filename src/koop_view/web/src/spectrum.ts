// Amplitude spectrum of evenly spaced samples.

/** Fourier transform in place; the length is a power of two. */
export function fft(re: Float64Array, im: Float64Array): void {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i += 1) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) {
      [re[i], re[j]] = [re[j]!, re[i]!];
      [im[i], im[j]] = [im[j]!, im[i]!];
    }
  }
  for (let size = 2; size <= n; size *= 2) {
    const half = size / 2, angle = (-2 * Math.PI) / size;
    for (let k = 0; k < half; k += 1) {
      const c = Math.cos(angle * k), s = Math.sin(angle * k);
      for (let a = k; a < n; a += size) {
        const b = a + half;
        const x = re[b]! * c - im[b]! * s, y = re[b]! * s + im[b]! * c;
        re[b] = re[a]! - x;
        im[b] = im[a]! - y;
        re[a] = re[a]! + x;
        im[a] = im[a]! + y;
      }
    }
  }
}

/** Samples in the order of their steps, each missed one the same as the one before it. */
export function filled(steps: ArrayLike<number>, values: ArrayLike<number>, most: number): Float64Array {
  let begin = steps.length - 1;
  if (begin < 0) return new Float64Array(0);
  const end = steps[begin]!;
  // only what belongs to the run that goes on: steps that went back end it
  while (begin > 0 && steps[begin - 1]! < steps[begin]! && end - steps[begin - 1]! < most) begin -= 1;
  const found = new Float64Array(end - steps[begin]! + 1);
  let previous = 0, at = 0;
  for (let i = begin; i < steps.length; i += 1) {
    const place = steps[i]! - steps[begin]!;
    while (at < place) found[at++] = previous;
    previous = Number.isFinite(values[i]!) ? values[i]! : previous;
    found[at++] = previous;
  }
  return found;
}

/**
 * Amplitude over frequency [Hz], the mean removed, with a Hann window.
 *
 * A sine of amplitude A reads A at its frequency (up to 15 % less between two lines). Lines are
 * gathered into `bands` per decade, the largest of each: a peak keeps its height.
 */
export function spectrum(samples: Float64Array, dt: number, bands = 80): { f: number[]; amplitude: number[] } {
  const n = samples.length, found = { f: [] as number[], amplitude: [] as number[] };
  if (n < 64 || !(dt > 0)) return found;
  let mean = 0;
  for (const v of samples) mean += v / n;
  let size = 1;
  while (size < n) size *= 2;
  const re = new Float64Array(size), im = new Float64Array(size);
  let sum = 0;
  for (let i = 0; i < n; i += 1) {
    const w = 0.5 - 0.5 * Math.cos((2 * Math.PI * (i + 0.5)) / n);
    re[i] = w * (samples[i]! - mean);
    sum += w;
  }
  fft(re, im);
  let band = NaN;
  for (let k = Math.max(1, Math.ceil(size / n)); k <= size / 2; k += 1) {
    const f = k / (size * dt), a = (2 * Math.hypot(re[k]!, im[k]!)) / sum;
    const own = Math.floor(Math.log10(f) * bands), at = found.f.length - 1;
    if (own !== band) {
      found.f.push(f);
      found.amplitude.push(a);
      band = own;
    } else if (a > found.amplitude[at]!) {
      found.f[at] = f;
      found.amplitude[at] = a;
    }
  }
  return found;
}
