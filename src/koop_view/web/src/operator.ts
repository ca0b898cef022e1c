// What the operator does to the loop: requested, confirmed where it moves the rig, answered.

import { byId, make, setOptions, setText } from "./dom";
import { clock, formatKnobs, readKnobs, short } from "./format";
import type { Link, Message } from "./link";
import type { Loop } from "./loop";

const MOST_ACTS = 50;
const [DOUBLE, STRING, DOUBLE_ARRAY] = [3, 4, 8]; // rcl_interfaces/msg/ParameterType

type NodeRole = "controller" | "guard" | "lifter";

/** What the operator sees. */
export interface Desk {
  loop: Loop | undefined;
  operate: boolean;
  limits: [number, number][]; // of theta, of each knob; empty: not known
  each(name: string): number[]; // a parameter of the controller, for each knob
  parameter(name: string): unknown; // `controller.theta_min`
}

export class Operator {
  private shown = ""; // limits in the inputs, which the operator may have changed

  constructor(
    private readonly desk: Desk,
    private readonly link: Link,
  ) {
    // holding moves nothing: it is done at once
    byId("hold").onclick = () => void this.call("hold θ", "hold", { data: true });
    byId("resume").onclick = () => void this.resume();
    byId("reset").onclick = () => void this.reset();
    byId("trip").onclick = () => void this.call("trip", "trip", {}, "guard");
    byId("rearm").onclick = () => void this.rearm();
    byId("use-model").onclick = () => void this.useModel();
    byId("limits-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.setLimits();
    });
    for (const answer of ["yes", "no"]) {
      byId(`confirm-${answer}`).onclick = () => byId<HTMLDialogElement>("confirm").close(answer);
    }
  }

  /** Show what may be done now, and in the inputs the values of the loop. */
  refresh(): void {
    const { loop, operate, limits } = this.desk;
    document.body.dataset["operate"] = String(operate);
    this.allow("hold", "controller", "hold");
    this.allow("resume", "controller", "hold");
    this.allow("reset", "controller", "reset");
    const hasLimits = limits.length > 0; // a commander has none
    this.allow("set-limits", "controller", "set_parameters_atomically", hasLimits);
    this.showGuard();
    this.showProposal();
    byId("hold").classList.toggle("pressed", loop?.now.holding ?? false);
    byId("resume").classList.toggle("wanted", loop?.now.holding ?? false);
    const choice = byId<HTMLSelectElement>("limits-of");
    const knobs = loop?.knobs ?? [];
    choice.hidden = knobs.length < 2;
    setOptions(choice, knobs);
    const ends = limits[this.knob];
    if (!ends || `${this.knob} ${ends}` === this.shown) return;
    this.shown = `${this.knob} ${ends}`;
    byId<HTMLInputElement>("theta-min").value = String(ends[0]);
    byId<HTMLInputElement>("theta-max").value = String(ends[1]);
  }

  /** Let a button be pressed while a node offers its service. */
  private allow(id: string, node: NodeRole, service: string, wanted = true): void {
    const { loop, operate } = this.desk;
    const offered = this.link.offers(`${loop?.names[node]}/${service}`);
    byId<HTMLButtonElement>(id).disabled = !(operate && wanted && offered && !loop?.now.ended);
  }

  /** The knob whose limits are shown. */
  private get knob(): number {
    return Math.max(byId<HTMLSelectElement>("limits-of").selectedIndex, 0);
  }

  /** A line about the guard, if the loop has one, and what may be done with it. */
  private showGuard(): void {
    const { loop } = this.desk;
    const report = loop?.reports.get(loop.names.guard ?? "");
    byId("guard").hidden = !report;
    if (!report) return;
    const isTripped = report.values["status"] === "tripped";
    const where = isTripped ? `; θ is ${formatKnobs(readKnobs(report.values["theta"]))}` : "";
    setText(byId("guard-text"), `Guard: ${report.message}${where}`);
    this.allow("rearm", "guard", "rearm", isTripped);
    this.allow("trip", "guard", "trip", !isTripped);
  }

  /** The model that the lifter proposes after a change; empty: none. */
  private get proposal(): string {
    const { loop } = this.desk;
    return loop?.reports.get(loop.names.lifter ?? "")?.values["proposed_model"] ?? "";
  }

  private showProposal(): void {
    byId("proposal").hidden = !this.proposal;
    setText(byId("proposal-text"), `Since the rig has changed, a better model: ${this.proposal}`);
    this.allow("use-model", "lifter", "set_parameters_atomically");
  }

  private async useModel(): Promise<void> {
    const file = this.proposal;
    const text = `${file} replaces the lifter's model; θ is held until the filters have settled.`;
    if (!(await confirm("Use the new model", text))) return;
    const parameters = [{ name: "model", value: { type: STRING, string_value: file } }];
    await this.call("use the new model", "set_parameters_atomically", { parameters }, "lifter");
  }

  private async rearm(): Promise<void> {
    const text = "The controller begins again at theta_safe, if the cause is gone.";
    if (await confirm("Rearm the guard", text)) await this.call("rearm", "rearm", {}, "guard");
  }

  private async resume(): Promise<void> {
    const text = `The controller moves θ again, from ${formatKnobs(this.desk.loop?.now.theta)} on.`;
    if (await confirm("Resume", text)) await this.call("resume", "hold", { data: false });
  }

  private async reset(): Promise<void> {
    const { limits } = this.desk;
    const initial = this.desk
      .each("theta_initial")
      .map((value, i) => clamp(value, ...(limits[i] ?? [NaN, NaN])));
    const rate = this.desk.each("rate_limit");
    const text =
      `θ goes from ${formatKnobs(this.desk.loop?.now.theta)} to ` +
      `${initial.length ? formatKnobs(initial) : "its initial value"}, ` +
      `${rate.some((value) => value > 0) ? `at most ${formatKnobs(rate)} per second` : "at once"}. ` +
      "Filter and relay start again.";
    if (await confirm("Reset", text)) await this.call("reset", "reset", {});
  }

  private async setLimits(): Promise<void> {
    const low = byId<HTMLInputElement>("theta-min").valueAsNumber;
    const high = byId<HTMLInputElement>("theta-max").valueAsNumber;
    if (Number.isNaN(low) || Number.isNaN(high)) return;
    const { knob, desk } = this;
    const words = [
      `The limits of ${desk.loop?.knobs[knob]} become [${short(low)}, ${short(high)}].`,
    ];
    const values: Record<string, number> = { theta_min: low, theta_max: high };
    const [theta, initial] = [
      desk.loop?.now.theta[knob] ?? NaN,
      desk.each("theta_initial")[knob] ?? NaN,
    ];
    const isOutside = (v: number): boolean => low < high && (v < low || v > high);
    const inside = (v: number): number => clamp(v, low, high);
    if (isOutside(theta)) {
      words.push(`θ is outside now: it goes from ${short(theta)} to ${short(inside(theta))}.`);
    }
    if (isOutside(initial)) {
      values["theta_initial"] = inside(initial);
      words.push(`A reset goes to ${short(inside(initial))} then, not to ${short(initial)}.`);
    }
    if (!(await confirm("Limits of θ", words.join(" ")))) return;
    const parameters = Object.entries(values).map(([name, value]) => {
      const all = desk.each(name).map((old, i) => (i === knob ? value : old));
      const several = { type: DOUBLE_ARRAY, double_array_value: all };
      return { name, value: all.length > 1 ? several : { type: DOUBLE, double_value: value } };
    });
    const what = `limits [${short(low)}, ${short(high)}]`;
    await this.call(what, "set_parameters_atomically", { parameters });
  }

  /** Call a service of the controller, or of another node, and note its answer. */
  private async call(
    what: string,
    service: string,
    request: Message,
    node: NodeRole = "controller",
  ): Promise<void> {
    const outcome = make("span", { text: " …" });
    const entry = make("li", { data: { outcome: "asked" } }, make("b", { text: what }), outcome);
    byId("acts").prepend(entry);
    while (byId("acts").children.length > MOST_ACTS) byId("acts").lastElementChild?.remove();
    let isDone = false;
    let words = "";
    try {
      const answer = await this.link.call(`${this.desk.loop?.names[node]}/${service}`, request);
      const result = (answer["result"] ?? answer) as Message;
      const reason = String(result["message"] ?? result["reason"] ?? "");
      isDone = (result["success"] ?? result["successful"]) === true;
      if (isDone) words = reason ? `done: ${reason}` : "done";
      else words = `refused: ${reason || "no reason given"}`;
    } catch (error) {
      words = `not done: ${(error as Error).message}`;
    }
    entry.dataset["outcome"] = isDone ? "done" : "refused";
    setText(outcome, ` – ${words} (${clock(Date.now() / 1000)})`);
    this.refresh();
  }
}

function clamp(value: number, low: number, high: number): number {
  return Math.min(high, Math.max(low, value));
}

/** Ask the operator; the answer is no unless it is yes. */
function confirm(title: string, text: string): Promise<boolean> {
  const dialog = byId<HTMLDialogElement>("confirm");
  if (dialog.open) return Promise.resolve(false);
  setText(byId("confirm-title"), title);
  setText(byId("confirm-text"), text);
  dialog.returnValue = "";
  dialog.showModal();
  byId("confirm-no").focus();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
  });
}
