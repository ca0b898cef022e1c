// What the figures of the page and of a report have in common: colours, axes, marks, charts.

import uPlot from "uplot";
import { labels } from "./format";

export const COLORS = 8;
const FONT = "system-ui, sans-serif";
const MARK_ROWS = 5; // of names of marks, one below the other

/** A value of the style sheet, such as the colour `--ink`. */
export function style(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** A colour of the palette. */
export function color(index: number): string {
  return style(`--c${index % COLORS}`);
}

type Range = (u: uPlot, low: number | null, high: number | null) => [number, number];

/** Room around what is drawn, a share of its extent; `above` more of it for the names of marks. */
export function padded(log: boolean, share: number, above = 0): Range {
  return (_u, low, high) => {
    if (low === null || high === null || (log && low <= 0)) return log ? [0.1, 1] : [0, 1];
    if (log && low === high) return [low / 2, high * 2];
    if (log) return [low / 1.1, high * 1.1 * (high / low) ** above];
    const pad = (high - low) * share || Math.abs(high) * 0.1 || 1;
    return [low - pad, high + pad + (high - low) * above];
  };
}

/** Ticks of a logarithmic axis: round numbers, fewer of them the more decades there are. */
function decades(_u: uPlot, _axis: number, low: number, high: number): number[] {
  const span = Math.log10(high / low);
  const every = Math.max(1, Math.ceil(span / 5));
  const marks = span > 3 ? [1] : span > 1.2 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 7];
  const ticks: number[] = [];
  const first = Math.floor(Math.log10(low) / every) * every;
  for (let exponent = first; exponent <= Math.log10(high); exponent += every) {
    ticks.push(...marks.map((mark) => Number(`${mark}e${exponent}`)));
  }
  return ticks.filter((tick) => tick >= low * 0.999 && tick <= high * 1.001);
}

/** An axis, `size` pixels wide or high. */
export function axis(size: number, log: boolean, more: uPlot.Axis = {}): uPlot.Axis {
  return {
    size,
    labelSize: 20,
    labelFont: `12px ${FONT}`,
    font: `11px ${FONT}`,
    stroke: style("--ink"),
    grid: { stroke: style("--line"), width: 1 },
    ticks: { stroke: style("--line"), width: 1, size: 4 },
    values: (_u, splits) => labels(splits),
    ...(log && { splits: decades, filter: (_u, splits) => splits }),
    ...more,
  };
}

/** Draw where the axes are; `ratio` is how many dots of the screen are a pixel. */
export function clipped(
  u: uPlot,
  draw: (ctx: CanvasRenderingContext2D, ratio: number) => void,
): void {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.lineWidth = uPlot.pxRatio;
  draw(ctx, uPlot.pxRatio);
  ctx.restore();
}

/** A dashed line across the axes at a value. */
export function drawLevel(u: uPlot, scale: "x" | "y", value: number, stroke: string): void {
  clipped(u, (ctx, ratio) => {
    const { left, top, width, height } = u.bbox;
    const at = u.valToPos(value, scale, true);
    ctx.strokeStyle = stroke;
    ctx.setLineDash([5 * ratio, 4 * ratio]);
    ctx.beginPath();
    ctx.moveTo(scale === "x" ? at : left, scale === "x" ? top : at);
    ctx.lineTo(scale === "x" ? at : left + width, scale === "x" ? top + height : at);
    ctx.stroke();
  });
}

/** A span of x, shaded. */
export function drawSpan(u: uPlot, from: number, to: number, fill: string): void {
  clipped(u, (ctx) => {
    const [a, b] = [from, to].map((x) => u.valToPos(x, "x", true)) as [number, number];
    ctx.fillStyle = fill;
    ctx.fillRect(a, u.bbox.top, Math.max(1, b - a), u.bbox.height);
  });
}

/** A place on the x axis with its name, and between what it may be. */
export interface Mark {
  x: number;
  name: string;
  color: string;
  low?: number | null;
  high?: number | null;
}

/** Marks as lines, each with its name in the first row that has room. */
export function drawMarks(u: uPlot, marks: readonly Mark[]): void {
  const rows: [number, number][][] = [];
  for (const mark of marks) {
    drawSpan(u, mark.low ?? mark.x, mark.high ?? mark.x, `${mark.color}28`);
    drawLevel(u, "x", mark.x, mark.color);
    clipped(u, (ctx, ratio) => {
      ctx.font = `${11 * ratio}px ${FONT}`;
      ctx.textBaseline = "top";
      ctx.textAlign = "left";
      ctx.fillStyle = mark.color;
      const at = u.valToPos(mark.x, "x", true);
      const width = ctx.measureText(mark.name).width;
      const gap = 4 * ratio;
      const fits = at + gap + width < u.bbox.left + u.bbox.width;
      const left = fits ? at + gap : at - gap - width;
      const isFree = (row: [number, number][]): boolean =>
        row.every(([a, b]) => left + width + gap < a || left - gap > b);
      let row = rows.findIndex(isFree);
      if (row < 0) row = rows.push([]) - 1;
      if (row >= MARK_ROWS) return;
      rows[row]?.push([left, left + width]);
      ctx.fillText(mark.name, left, u.bbox.top + (3 + 14 * row) * ratio);
    });
  }
}

/** What a chart draws. */
export interface Drawing {
  options(width: number): uPlot.Options;
  /** Values; undefined if there are none yet, or still the same. */
  data(): uPlot.AlignedData | undefined;
  /** Another one takes other options. */
  shape?(): string;
}

/** A chart as wide as its element, with the colours of the light or the dark page. */
export class Chart {
  plot: uPlot | undefined;
  private shape = "";

  constructor(
    readonly holder: HTMLElement,
    private readonly drawing: Drawing,
  ) {
    new ResizeObserver(() => this.resize()).observe(holder);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.clear();
      this.draw();
    });
  }

  draw(): void {
    const shape = this.drawing.shape?.() ?? "";
    if (shape !== this.shape) this.clear();
    const data = this.drawing.data();
    if (this.plot) {
      if (data) this.plot.setData(data);
    } else if (this.holder.clientWidth > 0) {
      const options = this.drawing.options(this.holder.clientWidth);
      const empty = options.series.map(() => []) as unknown as uPlot.AlignedData;
      this.plot = new uPlot(options, data ?? empty, this.holder);
      this.shape = shape;
    }
  }

  private clear(): void {
    this.plot?.destroy();
    this.plot = undefined;
  }

  private resize(): void {
    const { plot, holder } = this;
    if (!plot) this.draw();
    else if (plot.width !== holder.clientWidth && holder.clientWidth > 0) {
      plot.setSize({ width: holder.clientWidth, height: plot.height });
    }
  }
}
