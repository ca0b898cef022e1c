// What is kept of one topic: the last samples as they came, and columns of everything before.

import { Columns } from "./columns";

export const SPANS = [60, 600, 3600, 0]; // [s]; 0: all
const COLUMNS = 600;
const ALL_COLUMNS = 4096; // finer: a part of a recording is looked at through them
const SAMPLES = 16384; // more than a minute at 200 Hz
const CLOCK_STEP = 5; // [s] by which time may go back before it is another time
const MOST_DRAWN = 4400; // samples of a curve; of more, the columns are drawn

type Values = (number | null)[];

/** One value of a topic over time. */
class Signal {
  readonly raw = new Float64Array(SAMPLES).fill(NaN);
  readonly columns = new Map(
    SPANS.map((span) => [span, new Columns(span, span ? COLUMNS : ALL_COLUMNS)]),
  );
}

/** The values of one topic. All of them have the same times. */
export class Stream {
  readonly signals = new Map<string, Signal>();
  private times = new Float64Array(SAMPLES);
  private steps = new Float64Array(SAMPLES);
  private next = 0; // index of the next sample, ever growing
  private since = 0; // index of the first sample after the last clear
  first = NaN;
  last = NaN; // receive time of the newest message [s]
  lastStep = -1;

  /** Messages since the last clear. */
  get count(): number {
    return this.next - this.since;
  }

  get kept(): number {
    return Math.min(this.count, SAMPLES);
  }

  /** The oldest time whose samples are kept as they came. */
  get rawFrom(): number {
    return this.kept ? this.times[(this.next - this.kept) % SAMPLES]! : Infinity;
  }

  /** Seconds between two messages, over all of them. */
  get meanPeriod(): number {
    return (this.last - this.first) / (this.count - 1);
  }

  clear(): void {
    this.signals.clear();
    this.since = this.next;
    this.first = this.last = NaN;
    this.lastStep = -1;
  }

  /** Take a message; `values` are those of `names`. */
  push(t: number, step: number, names: readonly string[], values: ArrayLike<number>): void {
    if (t < this.last - CLOCK_STEP) this.clear();
    if (Number.isNaN(this.first)) this.first = t;
    this.last = t;
    this.lastStep = step;
    const at = this.next % SAMPLES;
    this.times[at] = t;
    this.steps[at] = step;
    this.next += 1;
    names.forEach((name, i) => {
      const signal = this.signals.get(name) ?? new Signal();
      this.signals.set(name, signal);
      signal.raw[at] = values[i]!;
      for (const columns of signal.columns.values()) columns.push(t, values[i]!);
    });
  }

  /** The samples kept, oldest first, from a time on. */
  raw(name: string, from = -Infinity): { t: number[]; v: number[]; step: number[] } {
    const signal = this.signals.get(name);
    const samples = { t: [] as number[], v: [] as number[], step: [] as number[] };
    for (let i = this.next - this.kept; signal && i < this.next; i += 1) {
      const at = i % SAMPLES;
      if (this.times[at]! < from) continue;
      samples.t.push(this.times[at]!);
      samples.v.push(signal.raw[at]!);
      samples.step.push(this.steps[at]!);
    }
    return samples;
  }
}

/**
 * Curves of several signals of a stream over [from, to], on one time axis.
 *
 * Samples as they came where all are kept and there are not too many; otherwise the columns of
 * `span`, each drawn from its smallest to its largest value, in the order in which they came.
 */
export function curves(
  stream: Stream,
  names: readonly string[],
  from: number,
  to: number,
  span: number,
): [number[], ...Values[]] {
  if (to - from <= 20 && stream.rawFrom <= Math.max(from, stream.first)) {
    const samples = names.map((name) => stream.raw(name, from - 1));
    const t = samples[0]?.t ?? [];
    if (t.length <= MOST_DRAWN)
      return interrupt(
        t,
        samples.map((s) => s.v),
        1,
      );
  }
  const drawn = names.map((name) =>
    columnCurve(stream.signals.get(name)?.columns.get(span), from, to),
  );
  const width = stream.signals.get(names[0] ?? "")?.columns.get(span)?.width ?? 1;
  return interrupt(...align(drawn), Math.max(1, 3 * width));
}

function columnCurve(columns: Columns | undefined, from: number, to: number): Map<number, number> {
  const curve = new Map<number, number>();
  columns?.each(from, to, (t, low, high, rising) => {
    curve.set(t + 0.25 * columns.width, rising ? low : high);
    curve.set(t + 0.75 * columns.width, rising ? high : low);
  });
  return curve;
}

/** Put curves on the times of all of them. */
function align(drawn: Map<number, number>[]): [number[], Values[]] {
  const t = [...new Set(drawn.flatMap((curve) => [...curve.keys()]))].sort((a, b) => a - b);
  return [t, drawn.map((curve) => t.map((time) => curve.get(time) ?? null))];
}

/** Interrupt curves where nothing came for longer than `silence` and than samples usually take. */
function interrupt(t: number[], values: Values[], silence: number): [number[], ...Values[]] {
  const usual = (t.at(-1)! - t[0]!) / (t.length - 1);
  const longest = Math.max(silence, 10 * usual || 0);
  const times: number[] = [];
  const lines: Values[] = values.map(() => []);
  t.forEach((time, i) => {
    const before = t[i - 1] ?? time;
    if (time - before > longest) {
      times.push((time + before) / 2);
      for (const line of lines) line.push(null);
    }
    times.push(time);
    lines.forEach((line, k) => {
      const v = values[k]![i] ?? NaN;
      line.push(Number.isNaN(v) ? null : v);
    });
  });
  return [times, ...lines];
}
