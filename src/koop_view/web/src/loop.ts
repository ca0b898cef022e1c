// One closed loop as it is heard: what its messages say, kept for the figures. No drawing here.

import { judge, silence, worst, LEVELS, type Heard, type Judgement, type Level, type Report, type Node, type Row } from "./health";
import type { LoopNames } from "./link";
import { CostMap } from "./map";
import { Stream } from "./stream";

const FORGOTTEN = 60; // [s] without a report, after which a node that the loop does not need is taken for ended
const MOST_FLIPS = 4000, MOST_INTERVALS = 400, MOST_EVENTS = 200;

/** A time in which something held; `to` is open while it lasts. */
export interface Interval {
  from: number;
  to: number;
}

/** Something that happened once. */
export interface Event {
  t: number;
  text: string;
}

export interface Status {
  name: string;
  hardware: string;
  level: number;
  message: string;
  values: Record<string, string>;
}

export class Loop {
  readonly state = new Stream();
  readonly cost = new Stream();
  readonly theta = new Stream();
  readonly map = new CostMap();
  flips: { t: number; theta: number; epsilon: number }[] = [];
  holds: Interval[] = [];
  limited: Interval[] = [];
  events: Event[] = [];
  readonly reports = new Map<string, Report>();
  channels: string[] = [];
  source = -1;
  modelId = "";
  settling = false;
  r = NaN;
  yOut = NaN;
  value = NaN; // theta
  holding = false;
  saturated = false;
  commanded = false; // by what is no controller: it has no relay
  swing = NaN;
  gradient = NaN;
  noise = NaN;
  confidence = NaN;
  gone = false; // none of its nodes is left
  stamp = NaN; // of the newest state's header [s]; 0: the rig sets none
  private epsilon = 0;
  private heard = { state: heard(), cost: heard(), theta: heard() };

  constructor(public names: LoopNames) {}

  /** Take new names, but keep those of nodes that are gone: they are missing, not unknown. */
  rename(names: LoopNames): void {
    if (this.gone) { // what comes now is another loop: nobody of the last one is missing
      this.names = names;
      this.gone = false;
      return;
    }
    const kept = { ...names };
    for (const key of ["plant", "lifter", "controller", "state", "cost", "theta"] as const) kept[key] ??= this.names[key];
    this.names = kept;
  }

  get topics(): string[] {
    return [this.names.state, this.names.cost, this.names.theta].filter((name): name is string => name !== null);
  }

  /** The last node has left. What was drawn stays. */
  end(): void {
    if (this.gone) return;
    this.gone = true;
    this.reports.clear();
    this.heard = { state: heard(), cost: heard(), theta: heard() };
  }

  clear(): void {
    for (const stream of [this.state, this.cost, this.theta]) stream.clear();
    this.map.clear();
    this.flips = [];
    this.holds = [];
    this.limited = [];
    this.events = [];
    this.epsilon = 0;
    this.r = this.value = NaN;
    this.heard = { state: heard(), cost: heard(), theta: heard() };
  }

  take(topic: string, t: number, now: number, message: Record<string, unknown>): void {
    if (topic === this.names.state) this.takeState(t, now, message);
    else if (topic === this.names.cost) this.takeCost(t, now, message);
    else if (topic === this.names.theta) this.takeTheta(t, now, message);
  }

  private takeState(t: number, now: number, message: Record<string, unknown>): void {
    const x = message["x"] as Float64Array | undefined, step = Number(message["step"]);
    if (!x) return;
    if (x.length !== this.channels.length) this.channels = Array.from({ length: x.length }, (_, i) => `x[${i}]`);
    if (step < this.state.lastStep) {
      this.event(t, "restart");
      this.map.restart();
      this.epsilon = 0; // the relay of another run
    }
    const stamp = (message["header"] as { stamp: { sec: number; nanosec: number } }).stamp;
    this.stamp = stamp.sec + stamp.nanosec / 1e9;
    this.state.push(t, step, this.channels, x);
    hear(this.heard.state, now);
  }

  private takeCost(t: number, now: number, message: Record<string, unknown>): void {
    this.r = message["r"] as number;
    this.yOut = message["y_out"] as number;
    this.settling = message["settling"] === true;
    const source = message["source"] as number, model = message["model_id"] as string;
    if (this.source >= 0 && source !== this.source) this.event(t, `cost ${sourceName(source)}`);
    else if (this.source >= 0 && model !== this.modelId) this.event(t, `model ${model.slice(0, 6)}`);
    if (source !== this.source || model !== this.modelId) this.map.clear(); // r is another quantity now
    this.source = source;
    this.modelId = model;
    this.cost.push(t, Number(message["step"]), ["r", "y_out"], [this.r, this.yOut]);
    hear(this.heard.cost, now);
  }

  private takeTheta(t: number, now: number, message: Record<string, unknown>): void {
    const epsilon = message["epsilon"] as number;
    this.value = message["theta"] as number;
    this.holding = message["holding"] === true;
    this.saturated = message["saturated"] === true;
    this.swing = message["swing"] as number;
    this.gradient = message["gradient"] as number;
    this.noise = message["noise"] as number;
    this.confidence = message["confidence"] as number;
    this.commanded = epsilon === 0;
    if (this.epsilon && epsilon && epsilon !== this.epsilon) {
      this.flips.push({ t, theta: this.value, epsilon });
      if (this.flips.length > MOST_FLIPS) this.flips.splice(0, MOST_FLIPS / 4);
    }
    this.epsilon = epsilon;
    lasting(this.holds, this.holding && !this.commanded, t, this.theta.last); // a commander's theta moves
    lasting(this.limited, this.saturated, t, this.theta.last);
    this.theta.push(t, Number(message["step"]), ["theta"], [this.value]);
    if (!this.holding || this.commanded) this.map.push(t, this.value, this.r);
    hear(this.heard.theta, now);
  }

  report(status: Status, now: number): void {
    const level: Level = LEVELS[status.level] ?? "error";
    this.reports.set(status.name, { at: now, level, message: status.message, values: status.values });
  }

  event(t: number, text: string): void {
    this.events.push({ t, text });
    if (this.events.length > MOST_EVENTS) this.events.shift();
  }

  /** The nodes of the loop and what is thought of each. */
  rows(now: number, seen: "live" | "recorded" | "unknown"): Row[] {
    const { plant, lifter, controller, state, cost, theta } = this.names;
    const { heard: h, reports } = this;
    const nodes: Node[] = [
      { name: plant ?? state ?? "rig", role: "rig", report: plant ? reports.get(plant) : undefined, output: h.state, topic: state ?? "" },
    ];
    if (lifter) nodes.push({ name: lifter, role: "lifter", report: reports.get(lifter), output: h.cost, input: h.state, topic: cost ?? "" });
    if (controller) nodes.push({ name: controller, role: "controller", report: reports.get(controller), output: h.theta, input: h.cost, topic: theta ?? "" });
    const own = new Set([plant, lifter, controller]);
    for (const [name, report] of reports) {
      if (own.has(name)) continue;
      if (seen === "live" && now - report.at > FORGOTTEN) reports.delete(name);
      else nodes.push({ name, role: "other", report });
    }
    if (seen === "live" && this.gone) return nodes.map((node) => ({ node, judgement: GONE }));
    return nodes.map((node) => ({ node, judgement: seen === "live" ? judge(node, now) : seen === "recorded" ? said(node) : UNKNOWN }));
  }

  /** How a loop does that nobody looks at: by the reports of its nodes alone. */
  level(now: number): Level {
    if (this.gone) return "stale";
    const { plant, lifter, controller } = this.names;
    const own = [plant, lifter, controller].map((name) => (name ? this.reports.get(name) : undefined));
    const nodes = [...new Set([...own, ...this.reports.values()])].filter((report) => report !== undefined);
    return worst(nodes.map((report) => judge({ name: "", role: "other", report }, now).level));
  }

  /** Steps a second, by what was heard last; NaN: not known yet. */
  rate(now: number): number {
    return silence(this.heard.state, now) ? 0 : this.heard.state.rate || NaN;
  }

  /** Messages a second over all that was recorded. */
  meanRate(role: Node["role"]): string {
    const stream = role === "rig" ? this.state : role === "lifter" ? this.cost : role === "controller" ? this.theta : undefined;
    return stream && stream.last > stream.first ? String(Math.round((stream.count - 1) / (stream.last - stream.first))) : "";
  }

  hears(role: Node["role"]): Heard | undefined {
    return role === "rig" ? this.heard.state : role === "lifter" ? this.heard.cost : role === "controller" ? this.heard.theta : undefined;
  }
}

export function sourceName(source: number): string {
  return source === 1 ? "lifted" : source === 0 ? "raw" : "";
}

const UNKNOWN: Judgement = { level: "off", text: "unknown: no connection" };
const GONE: Judgement = { level: "off", text: "has left" };

/** In a recording nobody is late. */
function said(node: Node): Judgement {
  if (node.report) return { level: node.report.level, text: node.report.message || "no findings" };
  return node.output && Number.isFinite(node.output.at) ? { level: "ok", text: "in the recording" } : { level: "off", text: "not in the recording" };
}

function heard(): Heard & { since: number; n: number } {
  return { at: NaN, rate: 0, since: NaN, n: 0 };
}

/** Count arrivals second by second. */
function hear(h: Heard & { since: number; n: number }, now: number): void {
  if (Number.isNaN(h.since) || now - h.at > 5) {
    h.since = now;
    h.n = 0;
  }
  h.at = now;
  h.n += 1;
  const span = now - h.since;
  if (span >= 1) {
    h.rate = (h.n - 1) / span || h.rate;
    h.since = now;
    h.n = 1;
  }
}

/** Open, keep or close the newest interval. */
function lasting(intervals: Interval[], on: boolean, t: number, before: number): void {
  const end = intervals[intervals.length - 1];
  const open = end !== undefined && end.to === Infinity;
  if (on && !open) {
    intervals.push({ from: t, to: Infinity });
    if (intervals.length > MOST_INTERVALS) intervals.shift();
  } else if (!on && open) {
    end.to = Number.isFinite(before) ? Math.max(end.from, before) : t;
  }
}
