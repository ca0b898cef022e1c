// Which time the figures show.

import { clock } from "./format";
import { SPANS } from "./stream";

const SPAN_RAW = 10; // [s], drawn sample by sample
const DAY = 86400; // [s]
const STEPS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900];
const LONG_STEPS = [1800, 3600, 7200, 14400, 43200, DAY];

/** The time axis of all figures: it follows the newest message until a part is zoomed into. */
export class TimeAxis {
  span = 60; // [s]; 0: all
  recorded = false;
  private part: [number, number] | undefined;
  changed: () => void = () => undefined;

  constructor(
    private readonly first: () => number,
    private readonly now: () => number,
  ) {}

  follow(span: number): void {
    this.span = span;
    this.part = undefined;
    this.changed();
  }

  zoom(from: number, to: number): void {
    this.part = [from, to];
    this.changed();
  }

  get isZoomed(): boolean {
    return this.part !== undefined;
  }

  range(): [number, number] {
    if (this.part) return this.part;
    const now = this.now();
    if (!Number.isFinite(now)) return [0, 1];
    if (this.span > 0) return [now - this.span, now];
    const first = this.first();
    return now - first > 1 ? [first, now] : [now - 1, now];
  }

  /** The span of the columns that show the range best: the finest that reach back far enough. */
  columns(): number {
    const back = this.now() - this.range()[0];
    const finestOfAll = Math.max(this.now() - this.first(), 1) / 4096;
    const span = SPANS.find((s) => s > 0 && back <= s * 1.001) ?? 0;
    return span / 600 <= finestOfAll * 2 ? span : 0;
  }

  /** Milliseconds between two drawings: a column moves no sooner. */
  period(): number {
    if (this.part || this.span === 0 || this.span > 60) return 1000;
    return this.span === SPAN_RAW ? 140 : 350;
  }

  /** A time as the legend says it. */
  time(t: number): string {
    if (this.recorded) return `${(t - this.first()).toFixed(2)} s`;
    return `${clock(t)}${(t % 1).toFixed(2).slice(1)}`;
  }

  tick(t: number): string {
    if (!this.recorded) return clock(t);
    const seconds = t - this.first();
    return `${Number(seconds.toFixed(seconds < 100 ? 2 : 0))} s`;
  }

  ticks(low: number, high: number, width: number): number[] {
    const zero = this.recorded ? this.first() : (new Date().getTimezoneOffset() * 60) % DAY;
    const most = Math.max(2, Math.floor((width - 60) / 85));
    const isEnough = (step: number): boolean =>
      (high - low) / step <= most && (this.recorded || step >= 1);
    const step = [...STEPS, ...LONG_STEPS].find(isEnough) ?? DAY;
    const ticks: number[] = [];
    for (let t = zero + Math.ceil((low - zero) / step) * step; t <= high; t += step) ticks.push(t);
    return ticks;
  }
}
