// What is kept of one topic: the last samples as they came, and columns of everything before.

import { Columns, type Points } from "./columns";

export const SPANS = [60, 600, 3600, 0]; // [s]; 0: all
const COLUMNS = 600;
const ALL_COLUMNS = 4096; // finer: a part of a recording is looked at through them
const SAMPLES = 16384; // more than a minute at 200 Hz
const CLOCK_STEP = 5; // [s] by which time may go back before it is another time

/** One value of a topic over time. */
class Signal {
  readonly raw = new Float64Array(SAMPLES);
  readonly columns = new Map(SPANS.map((span) => [span, new Columns(span, span ? COLUMNS : ALL_COLUMNS)]));
}

/** The values of one topic. All of them have the same times. */
export class Stream {
  readonly signals = new Map<string, Signal>();
  private times = new Float64Array(SAMPLES);
  private steps = new Float64Array(SAMPLES);
  private next = 0; // index of the next sample, ever growing
  private since = 0; // index of the first sample after the last clear
  count = 0; // messages since the last clear
  first = NaN;
  last = NaN; // receive time of the newest message [s]
  lastStep = -1;

  get kept(): number {
    return Math.min(this.next - this.since, SAMPLES);
  }

  clear(): void {
    this.signals.clear();
    this.since = this.next;
    this.count = 0;
    this.first = this.last = NaN;
    this.lastStep = -1;
  }

  /** Take a message; `values` are those of `names`. */
  push(t: number, step: number, names: readonly string[], values: ArrayLike<number>): void {
    if (t < this.last - CLOCK_STEP) this.clear();
    this.count += 1;
    if (Number.isNaN(this.first)) this.first = t;
    this.last = t;
    this.lastStep = step;
    const at = this.next % SAMPLES;
    this.times[at] = t;
    this.steps[at] = step;
    this.next += 1;
    for (let i = 0; i < names.length; i += 1) {
      const name = names[i]!;
      let signal = this.signals.get(name);
      if (!signal) {
        signal = new Signal();
        signal.raw.fill(NaN);
        this.signals.set(name, signal);
      }
      const v = values[i]!;
      signal.raw[at] = v;
      for (const columns of signal.columns.values()) columns.push(t, v);
    }
  }

  /** The samples kept, oldest first, from time `from` on. */
  raw(name: string, from = -Infinity): { t: number[]; v: number[]; step: number[] } {
    const signal = this.signals.get(name), found = { t: [] as number[], v: [] as number[], step: [] as number[] };
    if (!signal) return found;
    for (let i = this.next - this.kept; i < this.next; i += 1) {
      const at = i % SAMPLES, t = this.times[at]!;
      if (t < from) continue;
      found.t.push(t);
      found.v.push(signal.raw[at]!);
      found.step.push(this.steps[at]!);
    }
    return found;
  }

  /** Messages per second over the last `window` seconds before `now`. */
  rate(now: number, window = 2): number {
    let n = 0;
    for (let i = this.next - 1; i >= this.next - this.kept; i -= 1) {
      if (this.times[i % SAMPLES]! < now - window) break;
      n += 1;
    }
    return n / window;
  }

  /** The oldest time of which samples are kept as they came. */
  get rawFrom(): number {
    return this.kept ? this.times[(this.next - this.kept) % SAMPLES]! : Infinity;
  }
}

/**
 * Curves of several signals of a stream over [from, to], on one time axis.
 *
 * Samples as they came where all are kept and there are not too many; otherwise the columns of `span`, each
 * drawn from its smallest to its largest value, in the order in which they came.
 */
export function curves(stream: Stream, names: readonly string[], from: number, to: number, span: number): [number[], ...(number | null)[][]] {
  const most = 3 * COLUMNS + 400;
  if (to - from <= 20 && stream.rawFrom <= Math.max(from, stream.first)) {
    const samples = names.map((name) => stream.raw(name, from - 1));
    if (samples[0] && samples[0].t.length <= 2 * most) {
      return broken(samples[0].t, samples.map((s) => s.v), 1);
    }
  }
  const drawn = names.map((name) => {
    const found = { t: [] as number[], v: [] as (number | null)[] };
    const columns = stream.signals.get(name)?.columns.get(span);
    columns?.each(from, to, (t, low, high, rising) => {
      found.t.push(t + 0.25 * columns.width, t + 0.75 * columns.width);
      found.v.push(rising ? low : high, rising ? high : low);
    });
    return found;
  });
  const width = stream.signals.get(names[0] ?? "")?.columns.get(span)?.width ?? 1;
  return broken(...joined(drawn), Math.max(1, 3 * width));
}

/** Put curves on the times of all of them. */
function joined(drawn: Points[]): [number[], (number | null)[][]] {
  const longest = drawn.reduce((a, b) => (b.t.length > a.t.length ? b : a), drawn[0] ?? { t: [], v: [] });
  if (drawn.every((p) => p.t.length === longest.t.length)) return [longest.t, drawn.map((p) => p.v)];
  const t = [...new Set(drawn.flatMap((p) => p.t))].sort((a, b) => a - b);
  return [t, drawn.map((p) => {
    const at = new Map(p.t.map((time, i) => [time, p.v[i]!]));
    return t.map((time) => at.get(time) ?? null);
  })];
}

/** Break the lines where nothing came for longer than `silence` and than some samples usually take. */
function broken(t: number[], values: (number | null)[][], silence: number): [number[], ...(number | null)[][]] {
  const usual = t.length > 1 ? (t[t.length - 1]! - t[0]!) / (t.length - 1) : 0;
  const longest = Math.max(silence, 10 * usual);
  const times: number[] = [], out: (number | null)[][] = values.map(() => []);
  for (let i = 0; i < t.length; i += 1) {
    if (i && t[i]! - t[i - 1]! > longest) {
      times.push((t[i]! + t[i - 1]!) / 2);
      for (const line of out) line.push(null);
    }
    times.push(t[i]!);
    for (let k = 0; k < out.length; k += 1) {
      const v = values[k]![i];
      out[k]!.push(v === undefined || v === null || Number.isNaN(v) ? null : v);
    }
  }
  return [times, ...out];
}
