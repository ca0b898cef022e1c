// One closed loop as it is heard: what its messages say, kept for the figures. No drawing here.

import { CostMap } from "./cost_map";
import type { Judgement, Level, LoopNode, LoopState, Report, Role, Row } from "./health";
import { judge, LEVELS, silence, worst } from "./health";
import type { LoopNames, Message } from "./link";
import { Stream } from "./stream";

const FORGOTTEN = 60; // [s] without a report: a node that the loop does not need has ended
const MOST_INTERVALS = 400;
const MOST_EVENTS = 200;
const MOST_POINTS = 2000; // of a path

/** A time in which something held; `to` is infinite while it lasts. */
export interface Interval {
  from: number;
  to: number;
}

/** A node's report, as it comes. */
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
  readonly all = [this.state, this.cost, this.theta];
  readonly map = new CostMap();
  readonly reports = new Map<string, Report>();
  holds: Interval[] = [];
  events: { t: number; text: string }[] = [];
  channels: string[] = [];
  knobs: string[] = ["theta"];
  source = -1; // of the cost: 0 raw, 1 lifted
  modelId = "";
  readonly now: LoopState = {
    ended: false,
    holding: false,
    commanded: false,
    settling: false,
    saturated: false,
    theta: [],
    r: NaN,
  };
  swing = NaN;
  gradient = NaN;
  confidence = NaN;

  constructor(public names: LoopNames) {}

  /** Take the names of the nodes that there are now. */
  rename(names: LoopNames): void {
    this.names = names;
    this.now.ended = false;
  }

  /** Names of the topics. */
  get topics(): string[] {
    const { state, cost, theta } = this.names;
    return [state, cost, theta].filter((name) => name !== null);
  }

  /** The last node has ended. The figures stay. */
  end(): void {
    if (this.now.ended) return;
    this.now.ended = true;
    this.reports.clear();
    for (const stream of this.all) stream.at = NaN;
  }

  clear(): void {
    for (const stream of this.all) stream.clear();
    this.map.clear();
    this.holds = [];
    this.events = [];
    this.now.r = NaN;
    this.now.theta = [];
  }

  /** Take a message that came at `t` on the server's clock, `now` on the page's. */
  take(topic: string, t: number, now: number, message: Message): void {
    if (topic === this.names.state) this.takeState(t, now, message);
    else if (topic === this.names.cost) this.takeCost(t, now, message);
    else if (topic === this.names.theta) this.takeTheta(t, now, message);
  }

  private takeState(t: number, now: number, message: Message): void {
    const x = message["x"] as Float64Array | undefined;
    const step = Number(message["step"]);
    if (!x) return;
    if (x.length !== this.channels.length) this.channels = Array.from(x, (_, i) => `x[${i}]`);
    if (step < this.state.lastStep) this.mark(t, "restart");
    this.state.push(t, step, this.channels, x, now);
  }

  private takeCost(t: number, now: number, message: Message): void {
    this.now.r = message["r"] as number;
    this.now.settling = message["settling"] === true;
    const source = message["source"] as number;
    const model = message["model_id"] as string;
    if (source !== this.source || model !== this.modelId) {
      const change =
        source !== this.source ? `cost ${costName(source)}` : `model ${model.slice(0, 6)}`;
      if (this.source >= 0) this.mark(t, change);
      this.map.clear(); // r is another quantity now
    }
    this.source = source;
    this.modelId = model;
    this.cost.push(t, Number(message["step"]), ["r"], [this.now.r], now);
  }

  private takeTheta(t: number, now: number, message: Message): void {
    const theta = message["theta"] as Float64Array;
    if (theta.length !== this.knobs.length) {
      this.knobs = Array.from(theta, (_, i) => (theta.length > 1 ? `theta[${i}]` : "theta"));
    }
    this.now.theta = Array.from(theta);
    this.now.holding = message["holding"] === true;
    this.now.saturated = message["saturated"] === true;
    this.swing = message["swing"] as number;
    this.gradient = message["gradient"] as number;
    this.confidence = message["confidence"] as number;
    this.now.commanded = message["epsilon"] === 0;
    const isHeld = this.now.holding && !this.now.commanded; // a commander moves theta
    extend(this.holds, isHeld, t, this.theta.last);
    this.theta.push(t, Number(message["step"]), this.knobs, theta, now);
    if (!this.now.holding || this.now.commanded) this.map.push(theta[0] ?? NaN, this.now.r);
  }

  /** Theta of two knobs over [from, to], oldest first, with the cost of the same step; thinned. */
  path(
    first: string,
    second: string,
    from: number,
    to: number,
  ): { x: number[]; y: number[]; r: number[] } {
    const [x, y] = [this.theta.raw(first, from, to), this.theta.raw(second, from, to)];
    const cost = this.cost.raw("r", from - 1, to);
    const costs = new Map(cost.step.map((step, i) => [step, cost.v[i]!]));
    const every = Math.ceil(x.v.length / MOST_POINTS);
    const some = x.step.map((_, i) => i).filter((i) => i % every === 0 && i < y.v.length);
    return {
      x: some.map((i) => x.v[i]!),
      y: some.map((i) => y.v[i]!),
      r: some.map((i) => costs.get(x.step[i]!) ?? NaN),
    };
  }

  report(status: Status, now: number): void {
    const { name, message, values } = status;
    this.reports.set(name, { at: now, level: LEVELS[status.level] ?? "error", message, values });
  }

  private mark(t: number, text: string): void {
    this.events.push({ t, text });
    if (this.events.length > MOST_EVENTS) this.events.shift();
  }

  /** The nodes of the loop and the judgement of each. */
  rows(now: number, mode: "live" | "recorded" | "unknown"): Row[] {
    return this.nodes(now, mode === "live").map((node) => {
      if (mode === "unknown") return { node, judgement: UNKNOWN };
      if (mode === "recorded") return { node, judgement: judgeRecorded(node) };
      return { node, judgement: this.now.ended ? ENDED : judge(node, now) };
    });
  }

  private nodes(now: number, live: boolean): LoopNode[] {
    const { plant, lifter, controller, state } = this.names;
    const { reports } = this;
    const node = (name: string, role: Role, output: Stream, input?: Stream): LoopNode => {
      return { name, role, report: reports.get(name), output, input };
    };
    const nodes = [node(plant ?? state ?? "rig", "rig", this.state)];
    if (lifter) nodes.push(node(lifter, "lifter", this.cost, this.state));
    if (controller) nodes.push(node(controller, "controller", this.theta, this.cost));
    for (const [name, report] of reports) {
      if ([plant, lifter, controller].includes(name)) continue;
      if (live && now - report.at > FORGOTTEN) reports.delete(name);
      else nodes.push({ name, role: "other", report });
    }
    return nodes;
  }

  /** The level of a loop that is not shown: by the reports of its nodes alone. */
  level(now: number): Level {
    if (this.now.ended) return "stale";
    const reports = [...this.reports.values()];
    return worst(reports.map((report) => judge({ name: "", role: "other", report }, now).level));
  }

  /** Steps per second, by the newest messages; NaN: not known yet. */
  rate(now: number): number {
    return silence(this.state, now) ? 0 : this.state.rate || NaN;
  }
}

export function costName(source: number): string {
  return ["raw", "lifted"][source] ?? "";
}

const UNKNOWN: Judgement = { level: "off", text: "unknown: no connection" };
const ENDED: Judgement = { level: "off", text: "has ended" };

/** In a recording nothing is late. */
function judgeRecorded({ report, output }: LoopNode): Judgement {
  if (report) return { level: report.level, text: report.message || "nothing to report" };
  if (output && Number.isFinite(output.at)) return { level: "ok", text: "in the recording" };
  return { level: "off", text: "not in the recording" };
}

/** Open, keep or close the newest interval. */
function extend(intervals: Interval[], on: boolean, t: number, before: number): void {
  const newest = intervals.at(-1);
  const isOpen = newest?.to === Infinity;
  if (on && !isOpen) intervals.push({ from: t, to: Infinity });
  if (intervals.length > MOST_INTERVALS) intervals.shift();
  if (!on && newest && isOpen) {
    newest.to = Number.isFinite(before) ? Math.max(newest.from, before) : t;
  }
}
