// Which time the figures show.

import { clock } from "./words";
import { SPANS } from "./stream";

export const SPAN_RAW = 10; // [s]: drawn sample by sample

/** The time axis of all figures: it follows what comes in, until somebody draws a part of it out. */
export class View {
  span = 60; // [s]; 0: all
  recorded = false;
  private part: [number, number] | undefined;
  changed: () => void = () => undefined;

  constructor(private readonly first: () => number, private readonly now: () => number) {}

  follow(span: number): void {
    this.span = span;
    this.part = undefined;
    this.changed();
  }

  zoom(from: number, to: number): void {
    this.part = [from, to];
    this.changed();
  }

  get zoomed(): boolean {
    return this.part !== undefined;
  }

  range(): [number, number] {
    if (this.part) return this.part;
    const now = this.now();
    if (!Number.isFinite(now)) return [0, 1];
    if (this.span > 0) return [now - this.span, now];
    const first = this.first();
    return Number.isFinite(first) && now - first > 1 ? [first, now] : [now - 1, now];
  }

  /** The columns that show the range best: the finest that reach back to its beginning. */
  columns(): number {
    const [from] = this.range(), back = this.now() - from;
    const first = this.first();
    const allFiner = Math.max(this.now() - first, 1) / 4096;
    const fitting = SPANS.filter((span) => span > 0 && back <= span * 1.001).sort((a, b) => a - b)[0];
    if (fitting === undefined) return 0;
    return fitting / 600 <= allFiner * 2 ? fitting : 0;
  }

  /** Milliseconds between two drawings: a column moves no sooner. */
  every(): number {
    if (this.part) return 1000;
    return this.span === SPAN_RAW ? 140 : this.span === 60 ? 350 : 1000;
  }

  /** What the legend says of a time. */
  time(t: number): string {
    return this.recorded ? `${(t - this.first()).toFixed(2)} s` : `${clock(t)}${(t % 1).toFixed(2).slice(1)}`;
  }

  tick(t: number): string {
    if (!this.recorded) return clock(t);
    const s = t - this.first();
    return `${Number(s.toFixed(s < 100 ? 2 : 0))} s`;
  }

  ticks(low: number, high: number, width: number): number[] {
    const zero = this.recorded ? this.first() : new Date().getTimezoneOffset() * 60 % 86400;
    const most = Math.max(2, Math.floor((width - 60) / 85)), steps = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400];
    const step = steps.find((s) => (high - low) / s <= most && (this.recorded || s >= 1)) ?? 86400;
    const found: number[] = [];
    for (let t = zero + Math.ceil((low - zero) / step) * step; t <= high; t += step) found.push(t);
    return found;
  }
}
