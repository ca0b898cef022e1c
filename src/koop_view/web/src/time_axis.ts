// Which time the figures show.

import { clock } from "./format";

const SPAN_RAW = 10; // [s], drawn sample by sample

/** The time axis of all figures: it follows the newest message until a part is zoomed into. */
export class TimeAxis {
  span = 60; // [s]; 0: all
  recorded = false; // times count from the begin of the recording
  part: [number, number] | undefined; // zoomed into
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

  range(): [number, number] {
    if (this.part) return this.part;
    const now = this.now();
    if (!Number.isFinite(now)) return [0, 1];
    if (this.span > 0) return [now - this.span, now];
    const first = this.first();
    return now > first ? [first, now] : [now - 1, now];
  }

  /** Milliseconds between two drawings: a column moves no sooner. */
  period(): number {
    if (this.part || this.span === 0 || this.span > 60) return 1000;
    return this.span === SPAN_RAW ? 140 : 350;
  }

  /** A time as the legend says it. */
  time(t: number): string {
    if (this.recorded) return `${t.toFixed(2)} s`;
    return `${clock(t)}${(t % 1).toFixed(2).slice(1)}`;
  }

  tick(t: number): string {
    return this.recorded ? `${Number(t.toFixed(4))} s` : clock(t);
  }
}
