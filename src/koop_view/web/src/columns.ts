// Smallest and largest value of equal spans of time: a curve of any length in bounded memory.

export const FINEST = 0.01; // [s]: the width of a column at first; others are FINEST * 2**k

/** What a column holds. */
export interface Column {
  low: number;
  high: number;
  rising: boolean; // whether the smallest value came first
}

/** Columns from the first value on: two neighbours become one whenever there is no room left. */
export class Columns {
  private readonly low: Float64Array;
  private readonly high: Float64Array;
  private readonly rising: Uint8Array;
  private first = NaN; // number of the oldest column; its time is first * width

  constructor(
    readonly count: number,
    public width = FINEST, // [s]
  ) {
    this.low = new Float64Array(count).fill(NaN);
    this.high = new Float64Array(count).fill(NaN);
    this.rising = new Uint8Array(count);
  }

  /** Take a value, or the column of finer ones; what is older than the first is left out. */
  push(t: number, low: number, high = low, rising = true): void {
    if (!Number.isFinite(low)) return;
    if (Number.isNaN(this.first)) this.first = Math.floor(t / this.width);
    while (Math.floor(t / this.width) - this.first >= this.count) this.halve();
    this.merge(Math.floor(t / this.width) - this.first, low, high, rising);
  }

  /** Column number `at`, which begins at `at * width`; undefined if it is empty. */
  get(at: number): Column | undefined {
    const k = at - this.first;
    const low = this.low[k] ?? NaN;
    if (Number.isNaN(low)) return undefined;
    return { low, high: this.high[k]!, rising: this.rising[k] === 1 };
  }

  /** Call `take(start, column)` for every column in [from, to] with a value. */
  each(from: number, to: number, take: (t: number, column: Column) => void): void {
    const end = Math.min(this.first + this.count - 1, Math.floor(to / this.width));
    for (let at = Math.max(this.first, Math.floor(from / this.width)); at <= end; at += 1) {
      const column = this.get(at);
      if (column) take(at * this.width, column);
    }
  }

  private merge(k: number, low: number, high: number, rising: boolean): void {
    if (k < 0) return;
    const isLower = !(low >= this.low[k]!); // also if there is none yet
    const isHigher = !(high <= this.high[k]!);
    if (isLower) this.low[k] = low;
    if (isHigher) this.high[k] = high;
    if (isLower || isHigher) this.rising[k] = Number(isLower && isHigher ? rising : isHigher);
  }

  /** Make one of every two columns. */
  private halve(): void {
    const before = this.first;
    this.first = Math.floor(before / 2);
    this.width *= 2;
    for (let k = 0; k < this.count; k += 1) {
      const [low, high, isRising] = [this.low[k]!, this.high[k]!, this.rising[k] === 1];
      this.low[k] = this.high[k] = NaN;
      if (Number.isNaN(low)) continue;
      this.merge(Math.floor((before + k) / 2) - this.first, low, high, isRising);
    }
  }
}
