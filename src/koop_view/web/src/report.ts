// The figures of a report, drawn from the JSON in it: the Figure of report/document.py.

import uPlot from "uplot";
import { axis, Chart, COLORS, color, drawMarks, padded, style } from "./chart";
import { short } from "./format";

const FEW = 12; // points of a line that are marked
const DAY = 86400; // [s]
/** uPlot's table of labels: least increment, and what stands below where the day changes. */
const TIMES: uPlot.Axis.Values = [
  [28 * DAY, "{MMM} {YYYY}", null, null, null, null, null, null, 1],
  [DAY, "{D} {MMM}", null, null, null, null, null, null, 1],
  [60, "{H}:{mm}", "\n{D} {MMM}", null, "\n{D} {MMM}", null, null, null, 1],
  [1, "{H}:{mm}:{ss}", "\n{D} {MMM}", null, "\n{D} {MMM}", null, null, null, 1],
];

interface Series {
  name: string;
  x: number[];
  y: (number | null)[];
  upper: (number | null)[];
  kind: "line" | "points" | "steps" | "band" | "bars" | "level";
  color: number;
}

interface Panel {
  x_label: string;
  y_label: string;
  series: Series[];
  log_x: boolean;
  log_y: boolean;
  ticks: string[];
  time: boolean; // x counts seconds since the epoch
  marks: { x: number; name: string; low: number | null; high: number | null; color: number }[];
}

/** The curves as uPlot wants them: one x for all, ascending. */
function align(panel: Panel): uPlot.AlignedData {
  const tables = panel.series.map((s) => {
    const columns = s.upper.length ? [s.x, s.y, s.upper] : [s.x, s.y];
    const falls = s.x.length > 1 && (s.x[0] ?? 0) > (s.x.at(-1) ?? 0);
    return falls ? columns.map((column) => [...column].reverse()) : columns;
  });
  return uPlot.join(tables as unknown as uPlot.AlignedData[]);
}

/** Whether the panel has one curve, beside levels to compare it with. */
function isSingle(panel: Panel): boolean {
  return panel.series.filter((s) => s.kind !== "level").length === 1;
}

/** How a series is drawn; a band and bars take two of uPlot's. */
function seriesOf(s: Series, single: boolean): uPlot.Series[] {
  const stroke = s.kind === "level" ? style("--ink") : color(s.color);
  const common: uPlot.Series = { label: s.name, stroke, width: 2, points: { show: false } };
  if (s.kind === "level") return [{ ...common, width: 1, dash: [5, 4] }];
  if (s.color >= COLORS) common.dash = [6, 4];
  const points = { show: true, size: 6, fill: stroke };
  switch (s.kind) {
    case "band": {
      const edge = { ...common, width: single ? 0.7 : 0 };
      return [edge, { ...edge }];
    }
    case "bars":
      return [
        { ...common, width: 1.5, paths: drawBars },
        { ...common, paths: () => null },
      ];
    case "points":
      return [{ ...common, paths: () => null, points: { ...points, size: 8 } }];
    case "steps":
      return [{ ...common, paths: uPlot.paths.stepped!({ align: 1 }) }];
    default:
      return [s.x.length <= FEW ? { ...common, points } : common];
  }
}

/** Series and bands of a panel. Those of one name share a row of the legend: a median, its band. */
function curves(panel: Panel): Pick<uPlot.Options, "series" | "bands"> {
  const series: uPlot.Series[] = [{ label: panel.x_label, value: (_u, x) => place(panel, x) }];
  const bands: uPlot.Band[] = [];
  const lowEdges = new Map<string, number>(); // of a band or bars, by name
  const single = isSingle(panel);
  for (const s of panel.series) {
    const low = series.length;
    series.push(...seriesOf(s, single));
    if (s.upper.length) lowEdges.set(s.name, low);
    if (s.kind === "band") {
      bands.push({ series: [low + 1, low], fill: color(s.color) + (single ? "e0" : "38") });
    }
  }
  for (const name of new Set(panel.series.map((s) => s.name))) {
    const low = lowEdges.get(name) ?? NaN;
    const row = series.filter((s, i) => i > 0 && s.label === name);
    const main = row.find((s) => s !== series[low] && s !== series[low + 1]) ?? row[0];
    const isEdge = main === series[low];
    for (const s of row) if (s !== main) s.class = "companion";
    if (!main) continue;
    main.value = (u, value: number | null, _i, at) => {
      if (at === null || at === undefined) return "";
      if (Number.isNaN(low)) return short(value);
      const edges = [low, low + 1].map((i) => short(u.data[i]?.[at])).join(" to ");
      return isEdge ? edges : `${short(value)} (${edges})`;
    };
  }
  return { series, bands };
}

/** From the values of a series up to those of the next one, with a bar at both ends. */
const drawBars: uPlot.Series.PathBuilder = (u, index, first, last) => {
  const stroke = new Path2D();
  const half = 4 * uPlot.pxRatio;
  for (let i = first; i <= last; i += 1) {
    const [x, low, high] = [u.data[0][i], u.data[index]?.[i], u.data[index + 1]?.[i]];
    if (x === undefined || low == null || high == null) continue;
    const at = u.valToPos(x, "x", true);
    const ends = [low, high].map((v) => u.valToPos(v, "y", true)) as [number, number];
    stroke.moveTo(at, ends[0]);
    stroke.lineTo(at, ends[1]);
    for (const end of ends) {
      stroke.moveTo(at - half, end);
      stroke.lineTo(at + half, end);
    }
  }
  return { stroke };
};

function place(panel: Panel, x: number | null): string {
  if (x === null) return "";
  if (panel.time) return `${new Date(x * 1000).toISOString().slice(0, 16).replace("T", " ")} UTC`;
  return panel.ticks.length ? (panel.ticks[Math.round(x)] ?? "") : short(x);
}

/** What shares a row of the legend is shown and hidden together. */
function showTogether(u: uPlot, index: number | null, change: uPlot.Series): void {
  if (index === null || change.show === undefined) return;
  u.series.forEach((s, i) => {
    if (i && s.label === u.series[index]?.label && s.show !== change.show) {
      u.setSeries(i, { show: change.show as boolean });
    }
  });
}

/** Labels of the x axis: names, uPlot's own of times, or numbers. */
function xLabels(panel: Panel): uPlot.Axis {
  if (panel.time) return { size: 46, values: TIMES };
  if (!panel.ticks.length) return {};
  return {
    splits: () => panel.ticks.map((_name, i) => i),
    values: (_u, splits) => splits.map((v) => place(panel, v)),
  };
}

function options(panel: Panel, width: number): uPlot.Options {
  const hasSteps = panel.series.some((s) => s.kind === "steps");
  const marks = panel.marks.map((mark) => ({ ...mark, color: color(mark.color) }));
  return {
    width,
    tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1000), "Etc/UTC"),
    height: isSingle(panel) ? 190 : 280,
    ...curves(panel),
    scales: {
      x: { time: panel.time, distr: panel.log_x ? 3 : 1, range: padded(panel.log_x, 0.02) },
      y: {
        distr: panel.log_y ? 3 : 1,
        range: padded(panel.log_y, 0.05, marks.length ? 0.15 : 0),
      },
    },
    axes: [
      axis(34, panel.log_x, { label: panel.x_label, ...xLabels(panel) }),
      axis(58, panel.log_y, { label: panel.y_label }),
    ],
    cursor: {
      y: false,
      drag: { x: true, y: false },
      hover: { bias: hasSteps ? -1 : 0 },
      points: { size: 7 },
    },
    hooks: { setSeries: [showTogether], draw: [(u) => drawMarks(u, marks)] },
  };
}

const json = document.getElementById("figures")?.textContent ?? "{}";
const figures = JSON.parse(json) as Record<string, { panels: Panel[] }>;
const charts = [...document.querySelectorAll<HTMLElement>(".plot")].map((holder) => {
  const panel = figures[holder.dataset["figure"] ?? ""]?.panels[Number(holder.dataset["panel"])];
  if (!panel) throw new Error(`the report has no data for ${holder.dataset["figure"]}`);
  const drawing = { options: (width: number) => options(panel, width), data: () => align(panel) };
  const chart = new Chart(holder, drawing);
  chart.draw();
  return chart;
});

declare global {
  interface Window {
    drawn: (uPlot | undefined)[]; // for tests and the console
  }
}
window.drawn = charts.map((chart) => chart.plot);
