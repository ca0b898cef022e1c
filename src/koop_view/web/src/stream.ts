// What is kept of one topic: the last samples as they came, and columns of everything.

import { type Column, Columns, FINEST } from "./columns";

const COLUMNS = 16384; // of all time: a minute of a day has six or more
const SAMPLES = 131072; // ten minutes at 200 Hz
const CLOCK_STEP = 5; // [s] by which time may go back before it is another time
const MOST_DRAWN = 4400; // samples of a curve; of more, columns are drawn
const PAUSE = 5; // [s] without a message, after which the rate is measured again
const FEWEST_DRAWN = 600; // columns of a curve

type Values = (number | null)[];

/** One value of a topic over time. */
class Signal {
  readonly raw = new Float64Array(SAMPLES).fill(NaN);
  readonly columns = new Columns(COLUMNS);
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
  at = NaN; // when it came, on the page's clock [s]

  /** The oldest time whose samples are kept as they came. */
  get rawFrom(): number {
    return this.next > this.since ? this.times[this.oldest % SAMPLES]! : Infinity;
  }

  /** Messages per second in the second before the newest. */
  get rate(): number {
    const newest = this.next - 1;
    let i = newest;
    const ago = (k: number): number => this.last - this.times[k % SAMPLES]!;
    while (i > this.oldest && ago(i - 1) <= (i === newest ? PAUSE : 1)) i -= 1;
    return (newest - i) / ago(i) || 0;
  }

  private get oldest(): number {
    return Math.max(this.since, this.next - SAMPLES);
  }

  clear(): void {
    this.signals.clear();
    this.since = this.next;
    this.first = this.last = this.at = NaN;
    this.lastStep = -1;
  }

  /** Take a message that came at `t` on the server's clock; `values` are those of `names`. */
  push(
    t: number,
    step: number,
    names: readonly string[],
    values: ArrayLike<number>,
    now = NaN,
  ): void {
    if (t < this.last - CLOCK_STEP) this.clear();
    if (Number.isNaN(this.first)) this.first = t;
    this.last = t;
    this.lastStep = step;
    this.at = now;
    const at = this.next % SAMPLES;
    this.times[at] = t;
    this.steps[at] = step;
    this.next += 1;
    names.forEach((name, i) => {
      const signal = this.signals.get(name) ?? new Signal();
      this.signals.set(name, signal);
      signal.raw[at] = values[i]!;
      signal.columns.push(t, values[i]!);
    });
  }

  /** The samples kept within [from, to], oldest first. */
  raw(name: string, from = -Infinity, to = Infinity): { t: number[]; v: number[]; step: number[] } {
    const signal = this.signals.get(name);
    const samples = { t: [] as number[], v: [] as number[], step: [] as number[] };
    let i = this.next;
    while (i > this.oldest && this.times[(i - 1) % SAMPLES]! >= from) i -= 1;
    for (; signal && i < this.next; i += 1) {
      const at = i % SAMPLES;
      if (this.times[at]! > to) break;
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
 * Samples as they came where all are kept and there are not too many; otherwise columns, each drawn
 * from its smallest to its largest value, in the order in which they came.
 */
export function curves(
  stream: Stream,
  names: readonly string[],
  from: number,
  to: number,
): [number[], ...Values[]] {
  const isKept = stream.rawFrom <= Math.max(from, stream.first);
  const samples = isKept ? names.map((name) => stream.raw(name, from - 1, to + 1)) : [];
  const times = samples[0]?.t ?? [];
  if (isKept && times.length <= MOST_DRAWN) {
    const values = samples.map(({ v }) => v);
    return interrupt(times, values, 1);
  }
  const stored = names.map((name) => stream.signals.get(name)?.columns);
  const finest = isKept ? 0 : (stored[0]?.width ?? 0);
  const fine = FINEST * 2 ** Math.floor(Math.log2((to - from) / FEWEST_DRAWN / FINEST));
  const width = Math.max(fine, finest);
  const drawn = names.map((_name, i) => {
    const columns = new Columns(Math.ceil((to - from + 2) / width) + 2, width);
    samples[i]?.t.forEach((t, k) => {
      columns.push(t, samples[i]!.v[k]!);
    });
    if (!isKept) stored[i]?.each(from, to, (t, c) => columns.push(t, c.low, c.high, c.rising));
    return columns;
  });
  return interrupt(...edges(drawn, from, to), Math.max(1, 3 * width));
}

/** The edges of columns of one width as points of curves. */
function edges(drawn: Columns[], from: number, to: number): [number[], Values[]] {
  const width = drawn[0]?.width ?? 1;
  const times: number[] = [];
  const values: Values[] = drawn.map(() => []);
  for (let at = Math.floor(from / width); at <= to / width; at += 1) {
    const cells: (Column | undefined)[] = drawn.map((columns) => columns.get(at));
    if (cells.every((cell) => cell === undefined)) continue;
    times.push((at + 0.25) * width, (at + 0.75) * width);
    cells.forEach((cell, k) => {
      const ends = cell ? [cell.low, cell.high] : [null, null];
      values[k]!.push(...(cell?.rising === false ? ends.reverse() : ends));
    });
  }
  return [times, values];
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

/** Leave out what a logarithmic axis cannot show: x, and the curves over it. */
export function positive([x, ...curves]: [number[], ...Values[]]): [number[], ...Values[]] {
  return [x, ...curves.map((y) => y.map((v) => (v !== null && v > 0 ? v : null)))];
}
