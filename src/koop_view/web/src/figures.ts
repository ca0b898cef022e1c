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
import { byId, setOptions } from "./dom";
import { short } from "./format";
import type { Loop } from "./loop";
import type { Desk } from "./operator";
import { curves, positive, type Stream } from "./stream";
import type { TimeAxis } from "./time_axis";

/** One figure over time. */
interface TimeFigure {
  name: string;
  height: number;
  label: string;
  stream(loop: Loop): Stream;
  signals: readonly string[] | "channels" | "knobs";
  log?: boolean;
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
  private readonly figures: Figure[];

  constructor(
    private readonly desk: Desk,
    private readonly time: TimeAxis,
  ) {
    const marks = (u: uPlot): void => this.drawEvents(u);
    this.figures = [
      this.timeFigure({
        name: "theta",
        height: 200,
        label: "θ",
        stream: (loop) => loop.theta,
        signals: "knobs",
        withLimits: true,
        hooks: {
          drawClear: [(u) => this.drawHolds(u)],
          draw: [(u) => this.drawLimits(u, "y"), marks],
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
      new Figure("map", () => 250, this.mapDrawing()),
      new Figure("pair", () => 1000, this.pairDrawing()),
    ];
    byId("pair").addEventListener("change", () => this.redraw());
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
      return typeof signals === "string" ? (this.desk.loop?.[signals] ?? []) : signals;
    };
    return new Figure(figure.name, () => time.period(), {
      shape: () => `${names()} ${time.recorded}`,
      options: (width) => ({
        width,
        height: figure.height,
        series: [
          { label: "at", value: (_u, t: number | null) => (t === null ? "" : time.time(t)) },
          ...names().map((name, i) => line(name, color(i))),
        ],
        scales: {
          x: { time: !time.recorded, range: () => time.range() },
          y: {
            distr: figure.log ? 3 : 1,
            range: (u, low, high) => {
              const limits = figure.withLimits ? this.desk.limits.flat() : [];
              const pad = padded(figure.log === true, 0.06);
              if (low === null || high === null) return pad(u, low, high);
              return pad(u, Math.min(low, ...limits), Math.max(high, ...limits));
            },
          },
        },
        axes: [
          axis(24, false, {
            space: 80,
            values: (_u, splits) => splits.map((t) => time.tick(t)),
          }),
          axis(54, figure.log === true, { label: figure.label }),
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
        const { loop } = this.desk;
        if (!loop) return undefined;
        const data = curves(figure.stream(loop), names(), ...time.range());
        return (figure.log ? positive(data) : data) as uPlot.AlignedData;
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

  /** Where theta was held. */
  private drawHolds(u: uPlot): void {
    const { loop } = this.desk;
    const [from, to] = this.time.range();
    for (const hold of loop?.holds ?? []) {
      if (hold.to < from || hold.from > to) continue;
      const end = Math.min(to, hold.to, loop?.theta.last ?? to);
      drawSpan(u, Math.max(from, hold.from), end, `${style("--c6")}38`);
    }
  }

  /** theta's limits. */
  private drawLimits(u: uPlot, scale: "x" | "y"): void {
    const { limits } = this.desk;
    limits.forEach((ends, i) => {
      const stroke = limits.length > 1 ? color(i) : style("--ink");
      for (const value of ends) drawLevel(u, scale, value, stroke);
    });
  }

  /** Restarts, other costs and models, with their names. */
  private drawEvents(u: uPlot): void {
    const [from, to] = this.time.range();
    const events = this.desk.loop?.events.filter(({ t }) => t >= from && t <= to) ?? [];
    drawMarks(
      u,
      events.map(({ t, text }) => ({ x: t, name: text, color: style("--soft") })),
    );
  }

  private mapDrawing(): Drawing {
    return {
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
          y: { distr: 3, range: padded(true, 0.06) },
        },
        axes: [axis(24, false), axis(54, true, { label: "r" })],
        cursor: { y: false, drag: { x: false, y: false }, points: { size: 6 } },
        hooks: { draw: [(u) => this.drawLimits(u, "x"), (u) => this.drawNow(u)] },
      }),
      data: () => {
        const bins = this.desk.loop?.map.bins();
        return bins && positive([bins.theta, bins.least, bins.most, bins.mean]);
      },
    };
  }

  /** Of several knobs, let two be chosen. */
  showPairs(): void {
    const knobs = this.desk.loop?.knobs ?? [];
    for (const name of ["map", "pair"]) {
      byId(`${name}-figure`).hidden = knobs.length > 1 !== (name === "pair");
    }
    const pairs = knobs.flatMap((x, i) => knobs.slice(i + 1).map((y) => `${x} × ${y}`));
    setOptions(byId<HTMLSelectElement>("pair"), pairs);
  }

  private pairDrawing(): Drawing {
    const names = (): string[] => byId<HTMLSelectElement>("pair").value.split(" × ");
    let path = { x: [] as number[], y: [] as number[], r: [] as number[] };
    return {
      shape: () => names().join(),
      options: (width) => ({
        width,
        height: 320,
        legend: { show: false },
        series: [{}, { width: 0, points: { show: false } }],
        scales: {
          x: { time: false, range: padded(false, 0.06) },
          y: { range: padded(false, 0.06) },
        },
        axes: [
          axis(24, false, { label: names()[0] ?? "" }),
          axis(54, false, { label: names()[1] ?? "" }),
        ],
        cursor: { show: false },
        hooks: { draw: [(u) => drawPath(u, path)] },
      }),
      data: () => {
        const [first = "", second = ""] = names();
        const { loop } = this.desk;
        if (!loop || !second) return undefined;
        path = loop.path(first, second, ...this.time.range());
        return path.x.length ? [ends(path.x), ends(path.y)] : undefined;
      },
    };
  }

  /** Where the loop is now. */
  private drawNow(u: uPlot): void {
    const { theta: [theta] = [], r = NaN } = this.desk.loop?.now ?? {};
    if (theta === undefined || !Number.isFinite(r)) return;
    clipped(u, (ctx, ratio) => {
      ctx.fillStyle = color(1);
      ctx.beginPath();
      ctx.arc(u.valToPos(theta, "x", true), u.valToPos(r, "y", true), 4.5 * ratio, 0, 2 * Math.PI);
      ctx.fill();
    });
  }
}

/** The path of two knobs: a line, dots from blue to orange as r grows, and a ring where it ends. */
function drawPath(u: uPlot, { x, y, r }: { x: number[]; y: number[]; r: number[] }): void {
  const levels = r.map((value) => Math.log(value));
  const [low, high] = ends(levels.filter(Number.isFinite));
  clipped(u, (ctx, ratio) => {
    const at = (i: number): [number, number] => [
      u.valToPos(x[i]!, "x", true),
      u.valToPos(y[i]!, "y", true),
    ];
    ctx.strokeStyle = style("--soft");
    ctx.beginPath();
    for (let i = 0; i < x.length; i += 1) ctx.lineTo(...at(i));
    ctx.stroke();
    for (let i = 0; i < x.length; i += 1) {
      const share = (levels[i]! - low) / (high - low || 1);
      if (!Number.isFinite(share)) continue;
      ctx.fillStyle = `color-mix(in srgb, ${style("--c1")} ${Math.round(100 * share)}%, ${style("--c0")})`;
      ctx.beginPath();
      ctx.arc(...at(i), 3 * ratio, 0, 2 * Math.PI);
      ctx.fill();
    }
    if (!x.length) return;
    ctx.strokeStyle = style("--ink");
    ctx.lineWidth = 2 * ratio;
    ctx.beginPath();
    ctx.arc(...at(x.length - 1), 6 * ratio, 0, 2 * Math.PI);
    ctx.stroke();
  });
}

function ends(values: number[]): [number, number] {
  return [Math.min(...values), Math.max(...values)];
}

function line(label: string, stroke: string, more: uPlot.Series = {}): uPlot.Series {
  const value = (_u: uPlot, v: number | null): string => short(v);
  return { label, stroke, width: 1.25, points: { show: false }, spanGaps: false, value, ...more };
}
