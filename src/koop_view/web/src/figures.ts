// The figures: uPlot draws them, this says how.

import uPlot from "uplot";
import type { View } from "./view";
import type { Interval, Loop } from "./loop";
import { filled, spectrum } from "./spectrum";
import { curves } from "./stream";
import { short } from "./words";

const COLORS = 8;
const TRAIL = 60; // [s] of the way in r over theta
const BREAK = 1; // [s] without a point, after which the way goes on elsewhere
const SPECTRUM = 60; // [s]

export interface Limits {
  low: number;
  high: number;
}

export interface Source {
  loop(): Loop | undefined;
  limits(): Limits | undefined;
  dt(): number;
}

export function style(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

interface Figure {
  holder: HTMLElement;
  height: number;
  chart: uPlot | undefined;
  visible: boolean;
  make(width: number): uPlot.Options;
  refresh(chart: uPlot): void;
  every: number; // [ms] at most
  drawn: number;
  curves: number;
}

const font = "11px system-ui, sans-serif";

function axis(more: uPlot.Axis): uPlot.Axis {
  return {
    labelSize: 18, labelFont: "12px system-ui, sans-serif", font, stroke: style("--ink"),
    grid: { stroke: style("--line"), width: 1 }, ticks: { stroke: style("--line"), width: 1, size: 4 },
    values: (_u: uPlot, splits: number[]) => splits.map((v) => (v === null ? "" : short(v))), ...more,
  };
}

function padded(share: number): uPlot.Scale.Range {
  return (_u: uPlot, low: number | null, high: number | null): [number, number] => {
    if (low === null || high === null) return [0, 1];
    const pad = (high - low) * share || Math.abs(high) * 0.1 || 1;
    return [low - pad, high + pad];
  };
}

function padRatio(_u: uPlot, low: number | null, high: number | null): [number, number] {
  if (low === null || high === null || !(low > 0)) return [0.1, 1];
  return low < high ? [low / 1.15, high * 1.15] : [low / 2, high * 2];
}

function decades(_u: uPlot, _axis: number, low: number, high: number): number[] {
  const span = Math.log10(high / low), every = Math.max(1, Math.ceil(span / 5));
  const marks = span > 3 ? [1] : span > 1.2 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 7], ticks: number[] = [];
  const first = Math.floor(Math.log10(low) / every) * every;
  for (let e = first; e <= Math.log10(high); e += every) for (const m of marks) ticks.push(Number(`${m}e${e}`));
  return ticks.filter((v) => v >= low * 0.999 && v <= high * 1.001);
}

function line(label: string, color: string, more: uPlot.Series = {}): uPlot.Series {
  return { label, stroke: color, width: 1.25, points: { show: false }, spanGaps: false, value: (_u: uPlot, v: number | null) => short(v), ...more };
}

/** All figures of the page, drawn no more often than they need, and only where they are seen. */
export class Figures {
  private figures: Figure[] = [];
  private readonly sizes: ResizeObserver;
  private readonly sight: IntersectionObserver;
  logR = true;

  constructor(private readonly source: Source, private readonly view: View) {
    this.sizes = new ResizeObserver((changes) => {
      for (const { target } of changes) {
        const figure = this.figures.find((f) => f.holder === target);
        if (figure?.chart && figure.chart.width !== target.clientWidth) figure.chart.setSize({ width: target.clientWidth, height: figure.height });
      }
    });
    this.sight = new IntersectionObserver((changes) => {
      for (const { target, isIntersecting } of changes) {
        const figure = this.figures.find((f) => f.holder === target);
        if (figure) {
          figure.visible = isIntersecting;
          figure.drawn = 0;
        }
      }
    }, { rootMargin: "100px" });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.rebuild());
    this.timeFigure("theta", 200, "θ", () => ["theta"], (loop) => loop.theta, {
      wide: (low, high) => this.withLimits(low, high), hooks: { drawClear: [(u) => this.shades(u)], draw: [(u) => this.thetaMarks(u)] },
    });
    this.timeFigure("cost", 160, "r", () => ["r"], (loop) => loop.cost, { log: () => this.logR, hooks: { draw: [(u) => this.eventMarks(u)] } });
    this.timeFigure("state", 190, "state", () => this.source.loop()?.channels ?? [], (loop) => loop.state, {});
    this.timeFigure("energy", 140, "y_out", () => ["y_out"], (loop) => loop.cost, { color: 3, log: () => this.logR });
    this.mapFigure();
    this.spectrumFigure();
  }

  /** Draw what is due. */
  draw(now: number): void {
    for (const figure of this.figures) {
      if (!figure.visible || now - figure.drawn < figure.every) continue;
      this.ensure(figure);
      if (!figure.chart) continue;
      figure.drawn = now;
      figure.refresh(figure.chart);
    }
  }

  rebuild(): void {
    for (const figure of this.figures) {
      figure.chart?.destroy();
      figure.chart = undefined;
      figure.drawn = 0;
    }
  }

  redraw(): void {
    for (const figure of this.figures) figure.drawn = 0;
  }

  private ensure(figure: Figure): void {
    const wanted = figure.holder.dataset["figure"] === "state" || figure.holder.dataset["figure"] === "spectrum" ? this.source.loop()?.channels.length ?? 0 : 1;
    if (figure.chart && figure.curves !== wanted) {
      figure.chart.destroy();
      figure.chart = undefined;
    }
    if (figure.chart || figure.holder.clientWidth === 0) return;
    figure.curves = wanted;
    const options = figure.make(figure.holder.clientWidth);
    figure.chart = new uPlot(options, options.series.map(() => []) as unknown as uPlot.AlignedData, figure.holder);
  }

  private add(name: string, height: number, every: number, make: Figure["make"], refresh: Figure["refresh"]): void {
    const holder = document.querySelector<HTMLElement>(`.plot[data-figure="${name}"]`)!;
    this.figures.push({ holder, height, every, make, refresh, chart: undefined, visible: false, drawn: 0, curves: -1 });
    this.sizes.observe(holder);
    this.sight.observe(holder);
  }

  private timeFigure(
    name: string, height: number, label: string, names: () => readonly string[],
    stream: (loop: Loop) => Loop["state"],
    more: { wide?: (low: number, high: number) => [number, number]; hooks?: uPlot.Hooks.Arrays; log?: () => boolean; color?: number },
  ): void {
    const pad = padded(0.06), state = { log: false };
    const make = (width: number): uPlot.Options => {
      state.log = more.log?.() ?? false;
      return {
        width, height,
        series: [
          { label: "at", value: (_u: uPlot, t: number | null) => (t === null ? "" : this.view.time(t)) },
          ...names().map((key, i) => line(key, style(`--c${(i + (more.color ?? 0)) % COLORS}`))),
        ],
        scales: {
          x: { time: false, range: () => this.view.range() },
          y: {
            distr: state.log ? 3 : 1,
            range: (u: uPlot, low: number | null, high: number | null) => {
              if (state.log) return padRatio(u, low, high);
              const [a, b] = more.wide && low !== null && high !== null ? more.wide(low, high) : [low, high];
              return (pad as (u: uPlot, a: number | null, b: number | null, key: string) => [number, number])(u, a, b, "y");
            },
          },
        },
        axes: [
          axis({ size: 24, space: 80, splits: (u: uPlot, _i: number, low: number, high: number) => this.view.ticks(low, high, u.width), values: (_u: uPlot, splits: number[]) => splits.map((t) => this.view.tick(t)) }),
          axis({ label, size: 54, ...(state.log && { splits: decades, filter: (_u: uPlot, splits: number[]) => splits }) }),
        ],
        cursor: { y: false, sync: { key: "time" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 } },
        select: { show: true, left: 0, top: 0, width: 0, height: 0 },
        hooks: {
          ...more.hooks,
          setSelect: [(u: uPlot) => {
            if (u.select.width < 5) return;
            this.view.zoom(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          }],
        },
      };
    };
    const refresh = (chart: uPlot): void => {
      const loop = this.source.loop();
      if (!loop) return;
      if (more.log && more.log() !== state.log) {
        this.rebuild();
        return;
      }
      const [from, to] = this.view.range();
      const data = curves(stream(loop), names(), from, to, this.view.columns());
      if (state.log) for (const values of data.slice(1)) values.forEach((v, i) => { if (v !== null && v <= 0) values[i] = null; });
      chart.setData(data as unknown as uPlot.AlignedData);
    };
    this.add(name, height, 0, make, (chart) => {
      const figure = this.figures.find((f) => f.chart === chart);
      if (figure) figure.every = this.view.every();
      refresh(chart);
    });
  }

  private withLimits(low: number, high: number): [number, number] {
    const limits = this.source.limits();
    return limits ? [Math.min(low, limits.low), Math.max(high, limits.high)] : [low, high];
  }

  private clipped(u: uPlot, paint: (ctx: CanvasRenderingContext2D, ratio: number) => void): void {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    paint(ctx, uPlot.pxRatio);
    ctx.restore();
  }

  /** Where theta was held or at a limit. */
  private shades(u: uPlot): void {
    const loop = this.source.loop();
    if (!loop) return;
    this.clipped(u, (ctx) => {
      const paint = (intervals: Interval[], color: string): void => {
        ctx.fillStyle = color;
        const [from, to] = this.view.range();
        for (const interval of intervals) {
          if (interval.to < from || interval.from > to) continue;
          const a = u.valToPos(Math.max(from, interval.from), "x", true);
          const b = u.valToPos(Math.min(to, interval.to, loop.theta.last), "x", true);
          ctx.fillRect(a, u.bbox.top, Math.max(1, b - a), u.bbox.height);
        }
      };
      paint(loop.holds, `${style("--c6")}38`);
      paint(loop.limited, `${style("--c4")}30`);
    });
  }

  /** theta's limits as lines, its flips as arrows in the new direction. */
  private thetaMarks(u: uPlot): void {
    const loop = this.source.loop(), limits = this.source.limits();
    this.clipped(u, (ctx, ratio) => {
      if (limits) {
        ctx.strokeStyle = style("--ink");
        ctx.lineWidth = ratio;
        ctx.setLineDash([5 * ratio, 4 * ratio]);
        for (const value of [limits.low, limits.high]) {
          const y = u.valToPos(value, "y", true);
          ctx.beginPath();
          ctx.moveTo(u.bbox.left, y);
          ctx.lineTo(u.bbox.left + u.bbox.width, y);
          ctx.stroke();
        }
        ctx.setLineDash([]);
      }
      if (!loop) return;
      ctx.fillStyle = style("--c1");
      const [from, to] = this.view.range(), size = 4 * ratio;
      const seen = loop.flips.filter((flip) => flip.t >= from && flip.t <= to);
      if (seen.length > u.bbox.width / (3 * size)) return; // nothing would be told apart
      for (const flip of seen) {
        const x = u.valToPos(flip.t, "x", true), y = u.valToPos(flip.theta, "y", true), down = flip.epsilon > 0 ? 1 : -1;
        ctx.beginPath();
        ctx.moveTo(x, y + down * size);
        ctx.lineTo(x - size, y - down * size);
        ctx.lineTo(x + size, y - down * size);
        ctx.fill();
      }
    });
    this.eventMarks(u);
  }

  /** Restarts, other costs and models, with their names. */
  private eventMarks(u: uPlot): void {
    const loop = this.source.loop();
    if (!loop) return;
    this.clipped(u, (ctx, ratio) => {
      ctx.font = `${11 * ratio}px system-ui, sans-serif`;
      ctx.textAlign = "left";
      ctx.textBaseline = "bottom";
      ctx.fillStyle = ctx.strokeStyle = style("--soft");
      ctx.lineWidth = ratio;
      const [from, to] = this.view.range();
      let free = -Infinity;
      for (const event of loop.events) {
        if (event.t < from || event.t > to) continue;
        const x = u.valToPos(event.t, "x", true), wide = ctx.measureText(event.text).width;
        ctx.beginPath();
        ctx.moveTo(x, u.bbox.top);
        ctx.lineTo(x, u.bbox.top + u.bbox.height);
        ctx.stroke();
        if (x > free) {
          ctx.fillText(event.text, x + 3 * ratio, u.bbox.top + u.bbox.height - 2 * ratio);
          free = x + wide + 8 * ratio;
        }
      }
    });
  }

  private mapFigure(): void {
    const log = { on: false };
    const make = (width: number): uPlot.Options => {
      log.on = this.logR;
      const color = style("--c2");
      return {
        width, height: 240,
        series: [
          { label: "θ", value: (_u: uPlot, v: number | null) => short(v) },
          line("r least", color, { width: 0 }), line("largest", color, { width: 0 }), line("mean", color, { width: 2 }),
        ],
        bands: [{ series: [2, 1], fill: `${color}30` }],
        scales: {
          x: { time: false, range: (u: uPlot, low: number, high: number) => (padded(0.03) as (u: uPlot, a: number | null, b: number | null, key: string) => [number, number])(u, low, high, "x") },
          y: { distr: log.on ? 3 : 1, range: log.on ? padRatio : padded(0.06) },
        },
        axes: [axis({ size: 24 }), axis({ label: "r", size: 54, ...(log.on && { splits: decades, filter: (_u: uPlot, splits: number[]) => splits }) })],
        cursor: { y: false, drag: { x: false, y: false }, points: { size: 6 } },
        hooks: { draw: [(u: uPlot) => this.way(u)] },
      };
    };
    this.add("map", 240, 250, make, (chart) => {
      if (log.on !== this.logR) {
        this.rebuild();
        return;
      }
      const bins = this.source.loop()?.map.bins();
      if (bins) chart.setData([bins.theta, bins.least, bins.most, bins.mean]);
    });
  }

  private way(u: uPlot): void {
    const loop = this.source.loop(), limits = this.source.limits();
    if (!loop) return;
    this.clipped(u, (ctx, ratio) => {
      ctx.strokeStyle = style("--ink");
      ctx.lineWidth = ratio;
      ctx.setLineDash([5 * ratio, 4 * ratio]);
      for (const value of limits ? [limits.low, limits.high] : []) {
        const x = u.valToPos(value, "x", true);
        ctx.beginPath();
        ctx.moveTo(x, u.bbox.top);
        ctx.lineTo(x, u.bbox.top + u.bbox.height);
        ctx.stroke();
      }
      ctx.setLineDash([]);
      ctx.strokeStyle = style("--c0");
      ctx.beginPath();
      let before = -Infinity;
      for (const { t, theta, r } of loop.map.way(loop.theta.last - TRAIL)) {
        const x = u.valToPos(theta, "x", true), y = u.valToPos(r, "y", true);
        if (t - before > BREAK) ctx.moveTo(x, y);
        else ctx.lineTo(x, y);
        before = t;
      }
      ctx.stroke();
      if (Number.isFinite(loop.value) && Number.isFinite(loop.r)) {
        ctx.fillStyle = style("--c1");
        ctx.beginPath();
        ctx.arc(u.valToPos(loop.value, "x", true), u.valToPos(loop.r, "y", true), 4.5 * ratio, 0, 2 * Math.PI);
        ctx.fill();
      }
    });
  }

  private spectrumFigure(): void {
    const log = { splits: decades, filter: (_u: uPlot, splits: number[]) => splits };
    const make = (width: number): uPlot.Options => ({
      width, height: 220,
      series: [
        { label: "Hz", value: (_u: uPlot, v: number | null) => short(v) },
        ...(this.source.loop()?.channels ?? []).map((key, i) => line(key, style(`--c${i % COLORS}`))),
      ],
      scales: { x: { time: false, distr: 3, range: padRatio }, y: { distr: 3, range: padRatio } },
      axes: [axis({ label: "frequency [Hz]", size: 26, ...log }), axis({ label: "amplitude", size: 54, ...log })],
      cursor: { y: false, drag: { x: false, y: false }, points: { size: 6 } },
    });
    this.add("spectrum", 220, 2000, make, (chart) => {
      const loop = this.source.loop(), dt = this.source.dt();
      if (!loop || !(dt > 0)) return;
      const found = loop.channels.map((name) => {
        const { v, step } = loop.state.raw(name, loop.state.last - SPECTRUM);
        return spectrum(filled(step, v, 2 * SPECTRUM / dt), dt);
      });
      const f = found[0]?.f ?? [];
      if (!f.length) return;
      chart.setData(uPlot.join(found.map((s) => {
        const floor = Math.max(...s.amplitude) * 1e-5; // what is nothing but rounding would take all the room
        return [s.f, s.amplitude.map((a) => (a > floor ? a : null))] as unknown as uPlot.AlignedData;
      })));
      const samples = document.getElementById("spectrum-note");
      if (samples) samples.textContent = f.length ? `${short(loop.state.raw(loop.channels[0]!, loop.state.last - SPECTRUM).v.length * dt)} s, Hann window` : "";
    });
  }
}

