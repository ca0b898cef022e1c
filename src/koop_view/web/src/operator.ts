// What the operator does to the loop: requested, confirmed where it moves the rig, answered.

import { byId, make, onClick, setText } from "./dom";
import { clock, short } from "./format";
import type { Link, Message } from "./link";
import type { Loop } from "./loop";

const MOST_ACTS = 50;
const [DOUBLE, STRING] = [3, 4]; // rcl_interfaces/msg/ParameterType
const SETTLES = "θ is held until the filters have settled, then the new cost is sought.";

/** Inputs that show a parameter until the operator changes them. */
const INPUTS: Record<string, string> = {
  "theta-min": "controller.theta_min",
  "theta-max": "controller.theta_max",
  cost: "lifter.cost",
  model: "lifter.model",
};

/** What the operator sees. */
export interface Desk {
  loop: Loop | undefined;
  operate: boolean;
  parameter(name: string): unknown; // `controller.theta_min`
}

export class Operator {
  private readonly changed = new Set<string>(); // inputs

  constructor(
    private readonly desk: Desk,
    private readonly link: Link,
  ) {
    onClick(byId("hold"), () => void this.hold(true));
    onClick(byId("resume"), () => void this.resume());
    onClick(byId("reset"), () => void this.reset());
    const forms = {
      "limits-form": () => this.setLimits(),
      "cost-form": () => this.setCost(),
      "model-form": () => this.setModel(),
    };
    for (const [id, submit] of Object.entries(forms)) {
      byId(id).addEventListener("submit", (event) => {
        event.preventDefault();
        void submit();
      });
    }
    for (const id of Object.keys(INPUTS)) {
      byId(id).addEventListener("input", () => this.changed.add(id));
    }
    for (const answer of ["yes", "no"]) {
      onClick(byId(`confirm-${answer}`), () => byId<HTMLDialogElement>("confirm").close(answer));
    }
  }

  /** Show what may be done now, and in the inputs the values of the loop. */
  refresh(): void {
    const { loop, operate } = this.desk;
    const { controller, lifter } = loop?.names ?? {};
    document.body.dataset["operate"] = String(operate);
    const allow = (id: string, node: string | null | undefined, service: string): void => {
      const offered = node ? this.link.offers(`${node}/${service}`) : false;
      byId<HTMLButtonElement>(id).disabled = !(operate && !loop?.now.ended && offered);
    };
    // a commander has no limits to set, and what it records is not for the operator to change
    const isSought = this.desk.parameter("controller.theta_min") !== undefined;
    allow("hold", controller, "hold");
    allow("resume", controller, "hold");
    allow("reset", controller, "reset");
    allow("set-limits", isSought ? controller : null, "set_parameters_atomically");
    for (const id of ["set-cost", "set-model"]) {
      allow(id, loop?.now.commanded ? null : lifter, "set_parameters_atomically");
    }
    byId("hold").classList.toggle("pressed", loop?.now.holding ?? false);
    byId("resume").classList.toggle("wanted", loop?.now.holding ?? false);
    for (const [id, name] of Object.entries(INPUTS)) {
      const input = byId<HTMLInputElement>(id);
      const value = this.desk.parameter(name);
      const isTheirs = this.changed.has(id) || document.activeElement === input;
      if (value !== undefined && !isTheirs && input.value !== String(value)) {
        input.value = String(value);
      }
    }
  }

  /** Show the values of another loop. */
  forget(): void {
    this.changed.clear();
  }

  private number(name: string): number {
    return Number(this.desk.parameter(`controller.${name}`) ?? NaN);
  }

  /** Holding moves nothing: it is done at once. */
  private async hold(data: boolean): Promise<void> {
    await this.call(data ? "hold θ" : "resume", "controller", "hold", { data });
  }

  private async resume(): Promise<void> {
    const theta = short(this.desk.loop?.now.theta);
    if (await confirm("Resume", `The controller moves θ again, from ${theta} on.`)) {
      await this.hold(false);
    }
  }

  private async reset(): Promise<void> {
    const [low, high] = [this.number("theta_min"), this.number("theta_max")];
    const initial = clamp(this.number("theta_initial"), low, high);
    const limit = this.number("rate_limit");
    const text =
      `θ goes from ${short(this.desk.loop?.now.theta)} to ` +
      `${Number.isNaN(initial) ? "its initial value" : short(initial)}, ` +
      `${limit > 0 ? `at most ${short(limit)} per second` : "at once"}. ` +
      "Filter and relay start again.";
    if (await confirm("Reset", text)) await this.call("reset", "controller", "reset", {});
  }

  private async setLimits(): Promise<void> {
    const low = byId<HTMLInputElement>("theta-min").valueAsNumber;
    const high = byId<HTMLInputElement>("theta-max").valueAsNumber;
    if (Number.isNaN(low) || Number.isNaN(high)) return;
    const words = [`θ's limits become [${short(low)}, ${short(high)}].`];
    const values: Record<string, number> = { theta_min: low, theta_max: high };
    const [theta, initial] = [this.desk.loop?.now.theta ?? NaN, this.number("theta_initial")];
    const isOutside = (v: number): boolean => low < high && (v < low || v > high);
    const inside = (v: number): number => clamp(v, low, high);
    if (isOutside(theta)) {
      words.push(`θ is outside now: it goes from ${short(theta)} to ${short(inside(theta))}.`);
    }
    if (isOutside(initial)) {
      values["theta_initial"] = inside(initial);
      words.push(`A reset goes to ${short(inside(initial))} then, not to ${short(initial)}.`);
    }
    const what = `limits [${short(low)}, ${short(high)}]`;
    await this.set("Limits of θ", words.join(" "), what, "controller", values);
  }

  private async setCost(): Promise<void> {
    const cost = byId<HTMLSelectElement>("cost").value;
    const text = `The lifter changes to the cost "${cost}". ${SETTLES}`;
    await this.set("Cost", text, `cost ${cost}`, "lifter", { cost });
  }

  private async setModel(): Promise<void> {
    const model = byId<HTMLInputElement>("model").value.trim();
    const text = `The lifter loads ${model || "the shipped model"}. ${SETTLES}`;
    await this.set("Model", text, `model ${model}`, "lifter", { model });
  }

  /** Set parameters of a node once the operator has confirmed it. */
  private async set(
    title: string,
    text: string,
    what: string,
    role: "controller" | "lifter",
    values: Record<string, number | string>,
  ): Promise<void> {
    if (!(await confirm(title, text))) return;
    const parameters = Object.entries(values).map(([name, value]) => ({
      name,
      value:
        typeof value === "number"
          ? { type: DOUBLE, double_value: value }
          : { type: STRING, string_value: value },
    }));
    if (!(await this.call(what, role, "set_parameters_atomically", { parameters }))) return;
    for (const [id, name] of Object.entries(INPUTS)) {
      if (name.replace(`${role}.`, "") in values) this.changed.delete(id);
    }
    this.link.refresh();
  }

  /** Call a service of a node and note its answer; return whether it was done. */
  private async call(
    what: string,
    role: "controller" | "lifter",
    service: string,
    request: Message,
  ): Promise<boolean> {
    const outcome = make("span", { text: " …" });
    const entry = make("li", { data: { outcome: "asked" } }, make("b", { text: what }), outcome);
    byId("acts").prepend(entry);
    while (byId("acts").children.length > MOST_ACTS) byId("acts").lastElementChild?.remove();
    let isDone = false;
    let words = "";
    try {
      const answer = await this.link.call(`${this.desk.loop?.names[role]}/${service}`, request);
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
    return isDone;
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
