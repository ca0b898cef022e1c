// The figures of the page: what each shows, and how.

import type uPlot from "uplot";
import type { Drawing } from "./chart";
import {
  axis,
  Chart,
  clipped,
  color,
  drawLevel,
  drawMarks,
  drawSpan,
  padded,
  style,
} from "./chart";
import { short } from "./format";
import type { Interval, Loop } from "./loop";
import { curves, type Stream } from "./stream";
import type { TimeAxis } from "./time_axis";

const TRAIL = 60; // [s] of the path in r over theta
const BREAK = 1; // [s] without a point, after which the path is interrupted

/** What the figures show. */
export interface Shown {
  loop: Loop | undefined;
  limits: [number, number] | undefined; // of theta
}

/** One figure over time. */
interface TimeFigure {
  name: string;
  height: number;
  label: string;
  stream(loop: Loop): Stream;
  signals: readonly string[] | "channels";
  log?: boolean; // as the page says for r
  firstColor?: number;
  withLimits?: boolean; // the axis reaches from limit to limit
  hooks?: uPlot.Hooks.Arrays;
}

/** A chart that is drawn no more often than it needs, and only while it is in sight. */
class Figure {
  private readonly chart: Chart;
  private visible = false;
  private drawnAt = -Infinity;

  constructor(
    name: string,
    private readonly period: () => number, // [ms]
    drawing: Drawing,
  ) {
    const holder = document.querySelector<HTMLElement>(`.plot[data-figure="${name}"]`)!;
    this.chart = new Chart(holder, drawing);
    const sight = new IntersectionObserver(
      (entries) => {
        this.visible = entries.at(-1)?.isIntersecting ?? false;
        this.redraw();
      },
      { rootMargin: "100px" },
    );
    sight.observe(holder);
  }

  draw(now: number): void {
    if (!this.visible || now - this.drawnAt < this.period()) return;
    this.drawnAt = now;
    this.chart.draw();
  }

  redraw(): void {
    this.drawnAt = -Infinity;
  }
}

/** All figures of the page. */
export class Figures {
  logR = true;
  private readonly figures: Figure[];

  constructor(
    private readonly shown: () => Shown,
    private readonly time: TimeAxis,
  ) {
    const marks = (u: uPlot): void => this.drawEvents(u);
    this.figures = [
      this.timeFigure({
        name: "theta",
        height: 200,
        label: "θ",
        stream: (loop) => loop.theta,
        signals: ["theta"],
        withLimits: true,
        hooks: {
          drawClear: [(u) => this.drawIntervals(u)],
          draw: [(u) => this.drawLimits(u, "y"), (u) => this.drawFlips(u), marks],
        },
      }),
      this.timeFigure({
        name: "cost",
        height: 160,
        label: "r",
        stream: (loop) => loop.cost,
        signals: ["r"],
        log: true,
        hooks: { draw: [marks] },
      }),
      this.timeFigure({
        name: "state",
        height: 190,
        label: "state",
        stream: (loop) => loop.state,
        signals: "channels",
      }),
      this.timeFigure({
        name: "energy",
        height: 140,
        label: "y_out",
        stream: (loop) => loop.cost,
        signals: ["y_out"],
        log: true,
        firstColor: 3,
      }),
      new Figure("map", () => 250, this.mapDrawing()),
    ];
  }

  /** Draw what is due. */
  draw(now: number): void {
    for (const figure of this.figures) figure.draw(now);
  }

  redraw(): void {
    for (const figure of this.figures) figure.redraw();
  }

  private timeFigure(figure: TimeFigure): Figure {
    const { time } = this;
    const names = (): readonly string[] => {
      const { signals } = figure;
      return signals === "channels" ? (this.shown().loop?.channels ?? []) : signals;
    };
    const isLog = (): boolean => figure.log === true && this.logR;
    return new Figure(figure.name, () => time.period(), {
      shape: () => `${names()} ${isLog()} ${time.recorded}`,
      options: (width) => ({
        width,
        height: figure.height,
        series: [
          { label: "at", value: (_u, t: number | null) => (t === null ? "" : time.time(t)) },
          ...names().map((name, i) => line(name, color(i + (figure.firstColor ?? 0)))),
        ],
        scales: {
          x: { time: !time.recorded, range: () => time.range() },
          y: {
            distr: isLog() ? 3 : 1,
            range: (u, low, high) => {
              const limits = figure.withLimits ? this.shown().limits : undefined;
              const pad = padded(isLog(), 0.06);
              if (!limits || low === null || high === null) return pad(u, low, high);
              return pad(u, Math.min(low, limits[0]), Math.max(high, limits[1]));
            },
          },
        },
        axes: [
          axis(24, false, {
            space: 80,
            values: (_u, splits) => splits.map((t) => time.tick(t)),
          }),
          axis(54, isLog(), { label: figure.label }),
        ],
        cursor: {
          y: false,
          sync: { key: "time" },
          drag: { x: true, y: false, setScale: false },
          points: { size: 6 },
        },
        select: { show: true, left: 0, top: 0, width: 0, height: 0 },
        hooks: { ...figure.hooks, setSelect: [(u) => this.zoom(u)] },
      }),
      data: () => {
        const { loop } = this.shown();
        if (!loop) return undefined;
        const data = curves(figure.stream(loop), names(), ...time.range());
        return (isLog() ? positive(data) : data) as unknown as uPlot.AlignedData;
      },
    });
  }

  /** Look at the part that was selected with the pointer. */
  private zoom(u: uPlot): void {
    const { left, width } = u.select;
    if (width < 5) return;
    this.time.zoom(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
  }

  /** Where theta was held or at a limit. */
  private drawIntervals(u: uPlot): void {
    const { loop } = this.shown();
    const [from, to] = this.time.range();
    const draw = (intervals: Interval[], fill: string): void => {
      for (const interval of intervals) {
        if (interval.to < from || interval.from > to) continue;
        const end = Math.min(to, interval.to, loop?.theta.last ?? to);
        drawSpan(u, Math.max(from, interval.from), end, fill);
      }
    };
    draw(loop?.holds ?? [], `${style("--c6")}38`);
    draw(loop?.limited ?? [], `${style("--c4")}30`);
  }

  /** theta's limits. */
  private drawLimits(u: uPlot, scale: "x" | "y"): void {
    for (const value of this.shown().limits ?? []) drawLevel(u, scale, value, style("--ink"));
  }

  /** theta's flips as arrows in the new direction, unless there are too many to tell apart. */
  private drawFlips(u: uPlot): void {
    const [from, to] = this.time.range();
    const flips = this.shown().loop?.flips.filter(({ t }) => t >= from && t <= to) ?? [];
    clipped(u, (ctx, ratio) => {
      const size = 4 * ratio;
      if (flips.length > u.bbox.width / (3 * size)) return;
      ctx.fillStyle = color(1);
      for (const { t, theta, epsilon } of flips) {
        const [x, y] = [u.valToPos(t, "x", true), u.valToPos(theta, "y", true)];
        const tip = epsilon > 0 ? size : -size;
        ctx.beginPath();
        ctx.moveTo(x, y + tip);
        ctx.lineTo(x - size, y - tip);
        ctx.lineTo(x + size, y - tip);
        ctx.fill();
      }
    });
  }

  /** Restarts, other costs and models, with their names. */
  private drawEvents(u: uPlot): void {
    const [from, to] = this.time.range();
    const events = this.shown().loop?.events.filter(({ t }) => t >= from && t <= to) ?? [];
    drawMarks(
      u,
      events.map(({ t, text }) => ({ x: t, name: text, color: style("--soft") })),
    );
  }

  private mapDrawing(): Drawing {
    return {
      shape: () => String(this.logR),
      options: (width) => ({
        width,
        height: 240,
        series: [
          { label: "θ", value: (_u, v: number | null) => short(v) },
          line("r least", color(2), { width: 0 }),
          line("largest", color(2), { width: 0 }),
          line("mean", color(2), { width: 2 }),
        ],
        bands: [{ series: [2, 1], fill: `${color(2)}30` }],
        scales: {
          x: { time: false, range: padded(false, 0.03) },
          y: { distr: this.logR ? 3 : 1, range: padded(this.logR, 0.06) },
        },
        axes: [axis(24, false), axis(54, this.logR, { label: "r" })],
        cursor: { y: false, drag: { x: false, y: false }, points: { size: 6 } },
        hooks: { draw: [(u) => this.drawLimits(u, "x"), (u) => this.drawTrail(u)] },
      }),
      data: () => {
        const bins = this.shown().loop?.map.bins();
        return bins && [bins.theta, bins.least, bins.most, bins.mean];
      },
    };
  }

  /** The path of the last minute, and where the loop is now. */
  private drawTrail(u: uPlot): void {
    const { loop } = this.shown();
    if (!loop) return;
    const place = (theta: number, r: number): [number, number] => [
      u.valToPos(theta, "x", true),
      u.valToPos(r, "y", true),
    ];
    clipped(u, (ctx, ratio) => {
      ctx.strokeStyle = color(0);
      ctx.fillStyle = color(1);
      ctx.beginPath();
      let before = -Infinity;
      for (const { t, theta, r } of loop.map.trailSince(loop.theta.last - TRAIL)) {
        if (t - before > BREAK) ctx.moveTo(...place(theta, r));
        else ctx.lineTo(...place(theta, r));
        before = t;
      }
      ctx.stroke();
      if (!Number.isFinite(loop.now.theta) || !Number.isFinite(loop.now.r)) return;
      ctx.beginPath();
      ctx.arc(...place(loop.now.theta, loop.now.r), 4.5 * ratio, 0, 2 * Math.PI);
      ctx.fill();
    });
  }
}

function line(label: string, stroke: string, more: uPlot.Series = {}): uPlot.Series {
  const value = (_u: uPlot, v: number | null): string => short(v);
  return { label, stroke, width: 1.25, points: { show: false }, spanGaps: false, value, ...more };
}

/** Leave out what a logarithmic axis cannot show. */
function positive<T extends (number | null)[]>([t, ...values]: [number[], ...T[]]): unknown[] {
  return [t, ...values.map((v) => v.map((y) => (y !== null && y > 0 ? y : null)))];
}
