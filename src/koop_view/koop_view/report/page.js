"use strict";
// The figures of a page: uPlot draws them, this says how.

const FIGURES = JSON.parse(document.getElementById("figures").textContent);
const COLORS = 8;
const FEW = 12; // points of a line that are marked
const drawn = [];

function style(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function short(value) {
  if (value === null || value === undefined || !isFinite(value)) return "–";
  const size = Math.abs(value);
  if (value !== 0 && (size >= 1e5 || size < 1e-3)) {
    return value.toExponential(2).replace(/\.?0+e/, "e").replace("e+", "e");
  }
  return String(Number(value.toPrecision(4)));
}

// The curves as uPlot wants them: one x for all, ascending.
function aligned(panel) {
  return uPlot.join(panel.series.map((s) => {
    const columns = s.upper.length ? [s.x, s.y, s.upper] : [s.x, s.y];
    return s.x.length > 1 && s.x[0] > s.x.at(-1) ? columns.map((c) => [...c].reverse()) : columns;
  }));
}

// Series and bands of a panel. Those of one name share a row of the legend: a median and its band.
function curves(panel) {
  const series = [{ label: "at", value: (u, x) => place(panel, x) }], bands = [], pairs = [];
  const alone = single(panel);
  for (const s of panel.series) {
    const color = s.kind === "level" ? style("--ink") : style(`--c${s.color % COLORS}`);
    const dash = s.kind === "level" ? [5, 4] : s.color >= COLORS ? [6, 4] : undefined;
    const common = { label: s.name, stroke: color, dash, points: { show: false } };
    if (s.kind === "band") {
      const low = series.length;
      series.push({ ...common, width: alone ? 0.7 : 0 }, { ...common, width: alone ? 0.7 : 0 });
      bands.push({ series: [low + 1, low], fill: color + (alone ? "e0" : "38") });
      pairs.push([low + 1, low]);
    } else if (s.kind === "bars") {
      const low = series.length;
      series.push({ ...common, width: 1.5, paths: whiskers }, { ...common, paths: () => null });
      pairs.push([low + 1, low]);
    } else if (s.kind === "points") {
      series.push({ ...common, paths: () => null, points: { show: true, size: 8, fill: color } });
    } else if (s.kind === "steps") {
      series.push({ ...common, width: 2, paths: uPlot.paths.stepped({ align: 1 }) });
    } else {
      const marked = s.kind === "line" && s.x.length <= FEW;
      series.push({ ...common, width: s.kind === "level" ? 1 : 2, points: { show: marked, size: 6, fill: color } });
    }
  }
  for (const name of new Set(panel.series.map((s) => s.name))) {
    const edges = pairs.find(([high]) => series[high].label === name);
    const own = series.map((s, i) => i).filter((i) => i && series[i].label === name);
    const main = own.find((i) => !edges?.includes(i)) ?? own[0];
    series[main].value = (u, value, i, at) => {
      if (at === null) return "";
      if (!edges) return short(value);
      const [low, high] = [u.data[edges[1]][at], u.data[edges[0]][at]].map(short);
      return edges.includes(main) ? `${low} to ${high}` : `${short(value)} (${low} to ${high})`;
    };
    for (const i of own) if (i !== main) series[i].class = "companion";
  }
  return { series, bands };
}

// From the values of a series up to those of the next one, with a bar at both ends.
function whiskers(u, index, first, last) {
  const stroke = new Path2D(), half = 4 * uPlot.pxRatio, [x, low, high] = [u.data[0], u.data[index], u.data[index + 1]];
  for (let i = first; i <= last; i += 1) {
    if (low[i] === null || low[i] === undefined) continue;
    const at = u.valToPos(x[i], "x", true), ends = [low[i], high[i]].map((v) => u.valToPos(v, "y", true));
    stroke.moveTo(at, ends[0]);
    stroke.lineTo(at, ends[1]);
    for (const end of ends) {
      stroke.moveTo(at - half, end);
      stroke.lineTo(at + half, end);
    }
  }
  return { stroke };
}

// What is marked on the x axis: a line with its name, each in the first row that has room, and how far it may be off.
function marked(panel) {
  return (u) => {
    const { ctx, bbox } = u, ratio = uPlot.pxRatio, rows = [];
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.font = `${11 * ratio}px system-ui, sans-serif`;
    ctx.textBaseline = "top";
    ctx.textAlign = "left";
    for (const mark of panel.marks) {
      const [at, low, high] = [mark.x, mark.low ?? mark.x, mark.high ?? mark.x].map((v) => u.valToPos(v, "x", true));
      if (high < bbox.left || low > bbox.left + bbox.width) continue;
      const color = style(`--c${mark.color % COLORS}`);
      ctx.fillStyle = color + "28";
      ctx.fillRect(low, bbox.top, high - low, bbox.height);
      ctx.strokeStyle = ctx.fillStyle = color;
      ctx.lineWidth = 1.2 * ratio;
      ctx.setLineDash([5 * ratio, 4 * ratio]);
      ctx.beginPath();
      ctx.moveTo(at, bbox.top);
      ctx.lineTo(at, bbox.top + bbox.height);
      ctx.stroke();
      const wide = ctx.measureText(mark.name).width, gap = 4 * ratio;
      const left = at + gap + wide < bbox.left + bbox.width ? at + gap : at - gap - wide;
      let row = rows.findIndex((taken) => taken.every(([a, b]) => left + wide + gap < a || left - gap > b));
      if (row < 0) row = rows.push([]) - 1;
      rows[row].push([left, left + wide]);
      ctx.fillText(mark.name, left, bbox.top + (3 + 14 * row) * ratio);
    }
    ctx.restore();
  };
}

function place(panel, x) {
  return x === null ? "" : panel.ticks.length ? panel.ticks[Math.round(x)] ?? "" : short(x);
}

// Room around what is drawn; above it also for the names of marks.
function padded(log, share, above = 0) {
  return (u, low, high) => {
    if (low === null) return log ? [0.1, 1] : [0, 1];
    if (log) return low < high ? [low / 1.1, high * 1.1 * (high / low) ** above] : [low / 2, high * 2];
    const pad = (high - low) * share || Math.abs(high) * 0.1 || 1;
    return [low - pad, high + pad + (high - low) * above];
  };
}

// Ticks of a logarithmic axis: round numbers, fewer of them the more decades there are.
function decades(u, axis, low, high) {
  const span = Math.log10(high / low), every = Math.max(1, Math.ceil(span / 6));
  const marks = span > 3 ? [1] : span > 1.2 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 7];
  const ticks = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.log10(high); e += every) {
    for (const m of marks) ticks.push(Number(`${m}e${e}`));
  }
  return ticks.filter((v) => v >= low * 0.999 && v <= high * 1.001);
}

function options(panel, width) {
  const axis = (label, more) => ({
    label, labelSize: 22, labelFont: "12px system-ui, sans-serif", font: "11px system-ui, sans-serif",
    stroke: style("--ink"), grid: { stroke: style("--line"), width: 1 }, ticks: { stroke: style("--line"), width: 1, size: 5 },
    values: (u, splits) => splits.map((v) => (v === null ? "" : short(v))), ...more,
  });
  const names = panel.ticks.length && {
    splits: () => panel.ticks.map((name, i) => i), values: (u, splits) => splits.map((v) => place(panel, v)),
  };
  const log = { splits: decades, filter: (u, splits) => splits };
  const steps = panel.series.some((s) => s.kind === "steps");
  return {
    width, height: single(panel) ? 190 : 280, ...curves(panel),
    scales: {
      x: { time: false, distr: panel.log_x ? 3 : 1, range: padded(panel.log_x, 0.02) },
      y: { distr: panel.log_y ? 3 : 1, range: padded(panel.log_y, 0.05, panel.marks.length ? 0.15 : 0) },
    },
    axes: [
      axis(panel.x_label, { size: 34, ...(panel.log_x && log), ...names }),
      axis(panel.y_label, { size: 58, ...(panel.log_y && log) }),
    ],
    cursor: { y: false, drag: { x: true, y: false }, hover: { bias: steps ? -1 : 0 }, points: { size: 7 } },
    hooks: { setSeries: [together], draw: [marked(panel)] },
  };
}

function single(panel) {
  return panel.series.filter((s) => s.kind !== "level").length === 1;
}

// What shares a row of the legend comes and goes together.
function together(u, index, change) {
  if (index === null || change.show === undefined) return;
  u.series.forEach((s, i) => {
    if (i && s.label === u.series[index].label && s.show !== change.show) u.setSeries(i, { show: change.show });
  });
}

function draw(holder) {
  const panel = FIGURES[holder.dataset.figure].panels[holder.dataset.panel];
  const chart = new uPlot(options(panel, holder.clientWidth), aligned(panel), holder);
  drawn.push(chart);
  return chart;
}

const sizes = new ResizeObserver((changes) => {
  for (const { target } of changes) {
    const chart = drawn.find((u) => u.root.parentNode === target);
    if (chart && chart.width !== target.clientWidth) chart.setSize({ width: target.clientWidth, height: chart.height });
  }
});

const holders = document.querySelectorAll(".plot");
holders.forEach((holder) => { draw(holder); sizes.observe(holder); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  drawn.splice(0).forEach((chart) => chart.destroy());
  holders.forEach(draw);
});
