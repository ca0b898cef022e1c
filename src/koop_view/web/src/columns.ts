// Smallest and largest value of equal spans of time: a curve of any length in bounded memory.

/**
 * Columns over the last `span` seconds, or over all time.
 *
 * With a span the columns have a fixed width and the oldest give way. Without one, two neighbours
 * become one whenever there is no room left, so that the width doubles.
 */
export class Columns {
  width: number; // [s]
  private readonly low: Float64Array;
  private readonly high: Float64Array;
  private readonly rising: Uint8Array; // whether the smallest value came first
  private first = 0; // the oldest column that may hold something; its time is first * width
  private last = -1;

  constructor(
    readonly span: number,
    readonly count: number,
    finest = 0.01,
  ) {
    this.width = span > 0 ? span / count : finest;
    this.low = new Float64Array(count).fill(NaN);
    this.high = new Float64Array(count).fill(NaN);
    this.rising = new Uint8Array(count);
  }

  push(t: number, v: number): void {
    const at = Math.floor(t / this.width);
    if (this.last < this.first) this.first = this.last = at;
    if (this.span === 0 && at - this.first >= this.count) {
      this.halve();
      this.push(t, v);
      return;
    }
    if (at <= this.last - this.count) return; // older than all that is kept
    this.advance(at);
    this.first = Math.min(this.first, at);
    if (Number.isFinite(v)) this.merge(at, v, v, true);
  }

  /** Call `take(start, low, high, smallest first)` for every column in [from, to] with a value. */
  each(
    from: number,
    to: number,
    take: (t: number, low: number, high: number, rising: boolean) => void,
  ): void {
    const end = Math.min(this.last, Math.floor(to / this.width));
    for (let at = Math.max(this.first, Math.floor(from / this.width)); at <= end; at += 1) {
      const slot = this.slot(at);
      const low = this.low[slot]!;
      const isRising = this.rising[slot] === 1;
      if (!Number.isNaN(low)) take(at * this.width, low, this.high[slot]!, isRising);
    }
  }

  private slot(at: number): number {
    return ((at % this.count) + this.count) % this.count;
  }

  /** Take values into a column that came after those it holds. */
  private merge(at: number, low: number, high: number, rising: boolean): void {
    const slot = this.slot(at);
    const isLower = !(low >= this.low[slot]!); // also if there is none yet
    const isHigher = !(high <= this.high[slot]!);
    if (isLower) this.low[slot] = low;
    if (isHigher) this.high[slot] = high;
    if (isLower || isHigher) this.rising[slot] = Number(isLower && isHigher ? rising : isHigher);
  }

  /** Make room up to a column, forgetting the oldest. */
  private advance(at: number): void {
    for (let k = Math.max(this.last + 1, at - this.count + 1); k <= at; k += 1) {
      this.low[this.slot(k)] = this.high[this.slot(k)] = NaN;
    }
    this.last = Math.max(this.last, at);
    this.first = Math.max(this.first, this.last - this.count + 1);
  }

  /** Make one of every two columns. */
  private halve(): void {
    const columns: [number, number, number, boolean][] = [];
    this.each(-Infinity, Infinity, (t, low, high, rising) => {
      columns.push([Math.floor(Math.round(t / this.width) / 2), low, high, rising]);
    });
    this.low.fill(NaN);
    this.high.fill(NaN);
    this.width *= 2;
    this.first = Math.floor(this.first / 2);
    this.last = Math.floor(this.last / 2);
    for (const column of columns) this.merge(...column);
  }
}
