"use strict";
// Draws the figures of the report as SVG at the width that the window gives them, and lets the
// reader point at values, hide series and zoom in on a range of x.

const COLORS = ["#1f77b4", "#d95f02", "#1b9e77", "#7570b3", "#e7298a", "#66a61e", "#a6761d", "#666"];
const VIRIDIS = [[253, 231, 37], [94, 201, 98], [33, 145, 140], [59, 82, 139], [68, 1, 84]];
const NS = "http://www.w3.org/2000/svg";

function node(name, attributes, parent, text) {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  if (parent) parent.appendChild(element);
  return element;
}

function html(name, className, parent, text) {
  const element = document.createElement(name);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  parent.appendChild(element);
  return element;
}

function short(value) {
  if (value === null || value === undefined || !isFinite(value)) return "–";
  const size = Math.abs(value);
  if (value !== 0 && (size >= 1e5 || size < 1e-3)) return String(Number(value.toPrecision(3)).toExponential()).replace("e+", "e");
  return String(Number(value.toPrecision(4)));
}

function axis(low, high, log) {
  const f = log ? Math.log10 : (v) => v;
  let a = f(low), b = f(high);
  if (!(b > a)) { a -= 0.5; b += 0.5; }
  const ticks = [];
  if (log) {
    const decades = b - a, marks = decades > 4 ? [1] : decades > 1.2 ? [1, 3] : [1, 1.5, 2, 3, 4, 5, 7];
    const skip = Math.max(1, Math.ceil(decades / 6));
    for (let e = Math.floor(a); e <= b; e += 1) {
      if (e % skip) continue;
      for (const m of marks) { const v = m * 10 ** e; if (f(v) >= a - 1e-9 && f(v) <= b + 1e-9) ticks.push(v); }
    }
  }
  if (ticks.length < 2) {
    ticks.length = 0;
    const [c, d] = log ? [10 ** a, 10 ** b] : [a, b], rough = (d - c) / 5, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].find((m) => m * power >= rough) * power;
    for (let v = Math.ceil(c / step) * step; v <= d + step * 1e-6; v += step) ticks.push(Math.abs(v) < step * 1e-6 ? 0 : v);
  }
  return { place: (v) => (f(v) - a) / (b - a), value: (s) => (log ? 10 ** (a + s * (b - a)) : a + s * (b - a)), ticks };
}

function extent(values, log) {
  let low = Infinity, high = -Infinity;
  for (const v of values) {
    if (v === null || v === undefined || (log && v <= 0)) continue;
    if (v < low) low = v;
    if (v > high) high = v;
  }
  return low <= high ? [low, high] : log ? [0.1, 1] : [0, 1];
}

function path(points) {
  let text = "", pen = false;
  for (const p of points) {
    if (p === null) { pen = false; continue; }
    text += (pen ? "L" : "M") + p[0].toFixed(1) + " " + p[1].toFixed(1);
    pen = true;
  }
  return text;
}

function drawCurves(svg, box, panel, state) {
  const seen = panel.series.filter((s) => !state.hidden.has(s.name));
  const inside = (x) => !state.range || (x >= state.range[0] && x <= state.range[1]);
  const xs = state.range || extent(panel.series.flatMap((s) => s.x), panel.log_x);
  const ys = [];
  for (const s of seen) s.x.forEach((x, i) => { if (inside(x)) { ys.push(s.y[i]); if (s.upper.length) ys.push(s.upper[i]); } });
  if (panel.level !== null) ys.push(panel.level);
  let [low, high] = extent(ys, panel.log_y);
  if (!panel.log_y) { const pad = (high - low) * 0.05; low -= pad; high += pad; }
  else { low /= 1.08; high *= 1.08; }
  const pad = panel.log_x || state.range ? 0 : (xs[1] - xs[0]) * 0.02;
  const ax = axis(xs[0] - pad, xs[1] + pad, panel.log_x), ay = axis(low, high, panel.log_y);
  const X = (v) => box.x + ax.place(v) * box.w, Y = (v) => box.y + box.h - ay.place(v) * box.h;
  for (const v of ay.ticks) {
    node("line", { x1: box.x, x2: box.x + box.w, y1: Y(v), y2: Y(v), class: "grid" }, svg);
    node("text", { x: box.x - 6, y: Y(v) + 4, class: "tick end" }, svg, short(v));
  }
  const names = panel.ticks.map((text, i) => [i, text]);
  let edge = -Infinity;
  for (const [v, text] of names.length ? names : ax.ticks.map((v) => [v, short(v)])) {
    const width = text.length * 6.5;
    if (X(v) - width / 2 < edge) continue;
    edge = X(v) + width / 2 + 4;
    node("line", { x1: X(v), x2: X(v), y1: box.y + box.h, y2: box.y + box.h + 4, class: "axis" }, svg);
    node("text", { x: X(v), y: box.y + box.h + 17, class: "tick mid" }, svg, text);
  }
  const clip = "clip" + drawCurves.count++;
  node("rect", { x: box.x, y: box.y, width: box.w, height: box.h }, node("clipPath", { id: clip }, svg));
  const layer = node("g", { "clip-path": `url(#${clip})` }, svg);
  for (const s of seen) {
    const color = COLORS[s.color % COLORS.length];
    const dash = s.color >= COLORS.length ? "5 3" : "none";
    const at = (values) => s.x.map((x, i) => (values[i] === null || (panel.log_y && values[i] <= 0) ? null : [X(x), Y(values[i])]));
    if (s.kind === "band") {
      const lower = at(s.y).filter((p) => p), upper = at(s.upper).filter((p) => p).reverse();
      const alone = panel.series.length === 1;
      node("path", { d: path(lower.concat(upper)) + "Z", fill: color, "fill-opacity": alone ? 0.9 : 0.22, stroke: color, "stroke-width": alone ? 0.7 : 0, class: "data" }, layer);
    } else if (s.kind === "points" || s.x.length === 1) {
      for (const p of at(s.y)) if (p) node("circle", { cx: p[0], cy: p[1], r: 3.5, fill: color, class: "data" }, layer);
    } else {
      let points = at(s.y);
      if (s.kind === "steps") points = points.flatMap((p, i) => (i && p && points[i - 1] ? [[p[0], points[i - 1][1]], p] : [p]));
      node("path", { d: path(points), fill: "none", stroke: color, "stroke-width": 2, "stroke-dasharray": dash, class: "data" }, layer);
      if (s.x.length <= 12 && s.kind === "line") for (const p of at(s.y)) if (p) node("circle", { cx: p[0], cy: p[1], r: 2.5, fill: color }, layer);
    }
  }
  if (panel.level !== null) node("line", { x1: box.x, x2: box.x + box.w, y1: Y(panel.level), y2: Y(panel.level), class: "level" }, svg);
  return { X, value: (px) => ax.value((px - box.x) / box.w), seen };
}
drawCurves.count = 0;

function drawHeat(svg, box, panel) {
  const heat = panel.heat, w = box.w / heat.x.length, h = box.h / heat.y.length;
  const place = axis(heat.low, heat.high, true).place;
  heat.values.forEach((row, i) => row.forEach((value, j) => {
    const s = value === null ? 1 : Math.min(Math.max(place(value), 0), 1), k = Math.min(Math.floor(s * 4), 3), u = s * 4 - k;
    const rgb = VIRIDIS[k].map((c, n) => Math.round(c + u * (VIRIDIS[k + 1][n] - c)));
    const x = box.x + j * w, y = box.y + box.h - (i + 1) * h;
    const cell = node("rect", { x, y, width: w - 1, height: h - 1, fill: `rgb(${rgb})`, class: "data" }, svg);
    const text = `${panel.x_label} ${heat.x[j]}, ${panel.y_label} ${heat.y[i]}: ${value === null ? "diverged" : short(value)}`;
    node("title", {}, cell, text);
    cell.dataset.readout = text;
    node("text", { x: x + w / 2, y: y + h / 2 + 4, class: "cell", fill: s > 0.45 ? "#fff" : "#000" }, svg, value === null ? "–" : Math.round(value));
  }));
  heat.x.forEach((text, j) => node("text", { x: box.x + (j + 0.5) * w, y: box.y + box.h + 17, class: "tick mid" }, svg, text));
  heat.y.forEach((text, i) => node("text", { x: box.x - 6, y: box.y + box.h - (i + 0.5) * h + 4, class: "tick end" }, svg, text));
}

function readout(panel, state, x) {
  const lines = [`${panel.x_label} ${panel.ticks.length ? panel.ticks[Math.round(x)] || "" : short(x)}`];
  for (const s of panel.series) {
    if (state.hidden.has(s.name) || !s.x.length) continue;
    let best = 0;
    s.x.forEach((v, i) => { if (Math.abs(v - x) < Math.abs(s.x[best] - x)) best = i; });
    const text = short(s.y[best]) + (s.upper.length ? " to " + short(s.upper[best]) : "");
    lines.push(lines.at(-1).startsWith(s.name + ":") ? lines.pop() + ", median " + text : `${s.name}: ${text}`);
  }
  return lines.join("  ·  ");
}

function draw(panel, holder) {
  const state = { hidden: new Set(), range: null };
  if (panel.title) html("div", "panel-title", holder, panel.title);
  const plot = html("div", "plot", holder);
  const info = html("div", "readout", holder, panel.heat ? "" : "\u00a0");
  if (panel.series.length > 1) {
    const legend = html("div", "legend", holder);
    for (const s of panel.series.filter((s, i) => panel.series.findIndex((o) => o.name === s.name) === i)) {
      const button = html("button", "", legend, s.name);
      button.type = "button";
      button.style.setProperty("--c", COLORS[s.color % COLORS.length]);
      button.onclick = () => {
        if (!state.hidden.delete(s.name)) state.hidden.add(s.name);
        button.classList.toggle("off", state.hidden.has(s.name));
        render();
      };
    }
  }
  function render() {
    const width = Math.max(plot.clientWidth, 240), height = panel.heat ? 250 : panel.series.length === 1 ? 170 : 270;
    const box = { x: 62, y: 8, w: width - 74, h: height - 50 };
    plot.replaceChildren();
    const svg = node("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img" }, plot);
    const scale = panel.heat ? drawHeat(svg, box, panel) : drawCurves(svg, box, panel, state);
    node("rect", { x: box.x, y: box.y, width: box.w, height: box.h, class: "frame" }, svg);
    node("text", { x: box.x + box.w / 2, y: height - 6, class: "label mid" }, svg, panel.x_label);
    node("text", { transform: `translate(12 ${box.y + box.h / 2}) rotate(-90)`, class: "label mid" }, svg, panel.y_label);
    if (panel.heat) {
      svg.onpointermove = (e) => { info.textContent = e.target.dataset.readout || "\u00a0"; };
      return;
    }
    const line = node("line", { y1: box.y, y2: box.y + box.h, class: "cursor", visibility: "hidden" }, svg);
    const zoom = node("rect", { y: box.y, height: box.h, width: 0, class: "zoom" }, svg);
    let from = null;
    const at = (e) => Math.min(Math.max(e.clientX - svg.getBoundingClientRect().left, box.x), box.x + box.w);
    svg.onpointermove = (e) => {
      const px = at(e);
      line.setAttribute("x1", px); line.setAttribute("x2", px); line.setAttribute("visibility", "visible");
      info.textContent = readout(panel, state, scale.value(px));
      if (from !== null) { zoom.setAttribute("x", Math.min(from, px)); zoom.setAttribute("width", Math.abs(px - from)); }
    };
    svg.onpointerdown = (e) => { if (e.pointerType === "mouse") from = at(e); };
    svg.onpointerup = (e) => {
      if (from !== null && Math.abs(at(e) - from) > 8) {
        state.range = [scale.value(from), scale.value(at(e))].sort((a, b) => a - b);
        render();
      }
      from = null;
    };
    svg.ondblclick = () => { state.range = null; render(); };
  }
  render();
  let width = plot.clientWidth;
  new ResizeObserver(() => { if (plot.clientWidth !== width) { width = plot.clientWidth; render(); } }).observe(plot);
}

for (const holder of document.querySelectorAll("[data-figure]")) {
  const figure = FIGURES[holder.dataset.figure];
  const grid = html("div", "panels columns-" + figure.columns, holder);
  figure.panels.forEach((panel) => draw(panel, html("div", "panel", grid)));
}
document.body.dataset.drawn = document.querySelectorAll("svg .data").length;
