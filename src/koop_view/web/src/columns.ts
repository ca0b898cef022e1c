// Smallest and largest value of equal spans of time: a curve of any length in bounded memory.

/** Points of a curve; `null` breaks the line. */
export interface Points {
  t: number[];
  v: (number | null)[];
}

/**
 * Columns over the last `span` seconds, or over all time.
 *
 * With a span the columns have a fixed width and the oldest give way. Without one, two neighbours
 * become one whenever there is no room left, so that the width doubles.
 */
export class Columns {
  width: number;
  private low: Float64Array<ArrayBuffer>;
  private high: Float64Array<ArrayBuffer>;
  private rising: Uint8Array<ArrayBuffer>; // whether the smallest value came first
  private first = 0; // number of the oldest column that may hold something; number times width is its time
  private last = -1;

  constructor(readonly span: number, readonly count: number, finest = 0.01) {
    this.width = span > 0 ? span / count : finest;
    this.low = new Float64Array(count).fill(NaN);
    this.high = new Float64Array(count).fill(NaN);
    this.rising = new Uint8Array(count);
  }

  clear(): void {
    this.low.fill(NaN);
    this.high.fill(NaN);
    this.first = 0;
    this.last = -1;
  }

  push(t: number, v: number): void {
    let at = Math.floor(t / this.width);
    if (this.last < this.first) this.first = this.last = at;
    if (this.span > 0) {
      if (at <= this.last - this.count) return; // older than all that is kept
      this.advance(at);
      if (at < this.first) this.first = at;
    } else {
      if (at < this.first) at = this.first;
      while (at - this.first >= this.count) {
        this.halve();
        at = Math.floor(t / this.width);
      }
      if (at > this.last) this.last = at;
    }
    if (!Number.isFinite(v)) return;
    const slot = this.slot(at);
    const low = this.low[slot]!;
    if (Number.isNaN(low)) {
      this.low[slot] = this.high[slot] = v;
      this.rising[slot] = 1;
    } else if (v < low) {
      this.low[slot] = v;
      this.rising[slot] = 0;
    } else if (v > this.high[slot]!) {
      this.high[slot] = v;
      this.rising[slot] = 1;
    }
  }

  /** Call `take(start, low, high, smallest first)` for every column in [from, to] that holds something. */
  each(from: number, to: number, take: (t: number, low: number, high: number, rising: boolean) => void): void {
    const begin = Math.max(this.first, Math.floor(from / this.width));
    const end = Math.min(this.last, Math.floor(to / this.width));
    for (let at = begin; at <= end; at += 1) {
      const slot = this.slot(at);
      const low = this.low[slot]!;
      if (!Number.isNaN(low)) take(at * this.width, low, this.high[slot]!, this.rising[slot] === 1);
    }
  }

  private slot(at: number): number {
    return this.span > 0 ? ((at % this.count) + this.count) % this.count : at - this.first;
  }

  /** Make room up to column `at`, forgetting what is older than the span. */
  private advance(at: number): void {
    if (at <= this.last) return;
    if (at - this.last >= this.count) {
      this.low.fill(NaN);
      this.high.fill(NaN);
      this.first = at;
    } else {
      for (let k = this.last + 1; k <= at; k += 1) {
        const slot = this.slot(k);
        this.low[slot] = this.high[slot] = NaN;
      }
      this.first = Math.max(this.first, at - this.count + 1);
    }
    this.last = at;
  }

  /** Make one of every two columns. */
  private halve(): void {
    const first = Math.floor(this.first / 2), last = Math.floor(this.last / 2);
    const low = new Float64Array(this.count).fill(NaN), high = new Float64Array(this.count).fill(NaN);
    const rising = new Uint8Array(this.count);
    for (let at = first; at <= last; at += 1) {
      for (const old of [2 * at - this.first, 2 * at + 1 - this.first]) {
        if (old < 0 || old >= this.count || Number.isNaN(this.low[old]!)) continue;
        const slot = at - first;
        if (Number.isNaN(low[slot]!)) {
          low[slot] = this.low[old]!;
          high[slot] = this.high[old]!;
          rising[slot] = this.rising[old]!;
          continue;
        }
        if (this.low[old]! < low[slot]!) {
          low[slot] = this.low[old]!;
          rising[slot] = 0;
        }
        if (this.high[old]! > high[slot]!) {
          high[slot] = this.high[old]!;
          rising[slot] = 1;
        }
      }
    }
    [this.low, this.high, this.rising] = [low, high, rising];
    [this.first, this.last] = [first, last];
    this.width *= 2;
  }
}
