// What the operator does to the loop: asked for, confirmed where it moves the rig, answered with the reason.

import type { Link } from "./link";
import type { Loop } from "./loop";
import { byId, clock, make, say, short } from "./words";

const MOST_ACTS = 50;
const STRING = 4, DOUBLE = 3; // rcl_interfaces/msg/ParameterType

type Values = (name: string) => unknown;

export interface Desk {
  loop(): Loop | undefined;
  link: Link;
  operate(): boolean;
  parameter: Values; // of the controller or lifter: `controller.theta_min`
}

export class Operate {
  private dirty = new Set<string>(); // inputs that the operator has changed

  constructor(private readonly desk: Desk) {
    byId("hold").addEventListener("click", () => void this.hold(true));
    byId("resume").addEventListener("click", () => void this.resume());
    byId("reset").addEventListener("click", () => void this.reset());
    byId("limits-form").addEventListener("submit", (event) => { event.preventDefault(); void this.limits(); });
    byId("cost-form").addEventListener("submit", (event) => { event.preventDefault(); void this.cost(); });
    byId("model-form").addEventListener("submit", (event) => { event.preventDefault(); void this.model(); });
    for (const id of ["theta-min", "theta-max", "cost", "model"]) byId(id).addEventListener("input", () => this.dirty.add(id));
  }

  /** Show what may be done now, and in the inputs what is in force. */
  refresh(): void {
    const { loop, operate } = this.desk, names = loop()?.names;
    const may = operate() && names !== undefined && !loop()?.gone;
    document.body.dataset["operate"] = String(operate());
    const controller = names?.controller ?? "", lifter = names?.lifter ?? "";
    this.allow("hold", may && this.desk.link.offers(`${controller}/hold`));
    this.allow("resume", may && this.desk.link.offers(`${controller}/hold`));
    this.allow("reset", may && this.desk.link.offers(`${controller}/reset`));
    const limited = this.desk.parameter("controller.theta_min") !== undefined; // a commander has no limits that can be set
    this.allow("set-limits", may && limited && this.desk.link.offers(`${controller}/set_parameters_atomically`));
    const sought = !loop()?.commanded; // what a commander's excitation is recorded with is not the operator's
    for (const id of ["set-cost", "set-model"]) this.allow(id, may && sought && this.desk.link.offers(`${lifter}/set_parameters_atomically`));
    const holding = loop()?.holding ?? false;
    byId("hold").classList.toggle("pressed", holding);
    byId("resume").classList.toggle("wanted", holding);
    this.show("theta-min", "controller.theta_min");
    this.show("theta-max", "controller.theta_max");
    this.show("cost", "lifter.cost");
    this.show("model", "lifter.model");
  }

  forget(): void {
    this.dirty.clear();
  }

  private allow(id: string, may: boolean): void {
    const button = byId<HTMLButtonElement>(id);
    if (button.disabled === may) button.disabled = !may;
  }

  private show(id: string, name: string): void {
    const input = byId<HTMLInputElement | HTMLSelectElement>(id), value = this.desk.parameter(name);
    if (value === undefined || this.dirty.has(id) || document.activeElement === input) return;
    const text = String(value);
    if (input.value !== text) input.value = text;
  }

  private get theta(): string {
    return short(this.desk.loop()?.value);
  }

  /** Holding moves nothing: it is done at once. */
  private async hold(data: boolean): Promise<void> {
    const controller = this.desk.loop()?.names.controller;
    if (controller) await this.act(data ? "hold θ" : "resume", `${controller}/hold`, { data });
  }

  private async resume(): Promise<void> {
    if (await confirm("Resume", `The controller moves θ again, from ${this.theta} on.`)) await this.hold(false);
  }

  private async reset(): Promise<void> {
    const controller = this.desk.loop()?.names.controller;
    const value = (name: string): number => Number(this.desk.parameter(`controller.${name}`) ?? NaN);
    const initial = Math.min(value("theta_max"), Math.max(value("theta_min"), value("theta_initial")));
    const limit = Number(this.desk.parameter("controller.rate_limit") ?? 0);
    const how = limit > 0 ? `at most ${short(limit)} a second` : "at once";
    const to = Number.isNaN(initial) ? "its initial value" : short(initial);
    if (controller && (await confirm("Reset", `θ goes from ${this.theta} to ${to}, ${how}. Filter and relay begin again.`))) {
      await this.act("reset", `${controller}/reset`, {});
    }
  }

  private async limits(): Promise<void> {
    const controller = this.desk.loop()?.names.controller;
    const [low, high] = ["theta-min", "theta-max"].map((id) => byId<HTMLInputElement>(id).valueAsNumber) as [number, number];
    if (!controller || Number.isNaN(low) || Number.isNaN(high)) return;
    const now = this.desk.loop()?.value ?? NaN, initial = Number(this.desk.parameter("controller.theta_initial") ?? NaN);
    const words = [`θ's limits become [${short(low)}, ${short(high)}].`], parameters = [number("theta_min", low), number("theta_max", high)];
    if (low < high && (now < low || now > high)) words.push(`θ is outside now: it goes from ${short(now)} to ${short(Math.min(high, Math.max(low, now)))}.`);
    if (low < high && (initial < low || initial > high)) {
      const moved = Math.min(high, Math.max(low, initial));
      words.push(`The value that a reset goes to becomes ${short(moved)}; it was ${short(initial)}.`);
      parameters.push(number("theta_initial", moved));
    }
    if (!(await confirm("Limits of θ", words.join(" ")))) return;
    if (await this.act(`limits [${short(low)}, ${short(high)}]`, `${controller}/set_parameters_atomically`, { parameters })) {
      this.settled("theta-min", "theta-max");
    }
  }

  private async cost(): Promise<void> {
    const lifter = this.desk.loop()?.names.lifter, cost = byId<HTMLSelectElement>("cost").value;
    if (!lifter || !(await confirm("Cost", `The lifter changes to the cost "${cost}". θ is held until the filters have settled, then it is sought on the new cost.`))) return;
    if (await this.act(`cost ${cost}`, `${lifter}/set_parameters_atomically`, { parameters: [text("cost", cost)] })) this.settled("cost");
  }

  private async model(): Promise<void> {
    const lifter = this.desk.loop()?.names.lifter, path = byId<HTMLInputElement>("model").value.trim();
    if (!lifter || !(await confirm("Model", `The lifter loads ${path || "the shipped model"}. θ is held until the filters have settled, then it is sought on the new cost.`))) return;
    if (await this.act(`model ${path}`, `${lifter}/set_parameters_atomically`, { parameters: [text("model", path)] })) this.settled("model");
  }

  private settled(...ids: string[]): void {
    for (const id of ids) this.dirty.delete(id);
    this.desk.link.refresh();
  }

  /** Call a service and write down what it answered; return whether it was done. */
  private async act(what: string, service: string, request: Record<string, unknown>): Promise<boolean> {
    const entry = make("li", { data: { outcome: "asked" } }, make("b", { text: what }), make("span", { text: " …" }));
    const acts = byId("acts");
    acts.prepend(entry);
    while (acts.children.length > MOST_ACTS) acts.lastElementChild?.remove();
    const done = (outcome: string, words: string): void => {
      entry.dataset["outcome"] = outcome;
      say(entry.lastElementChild as HTMLElement, ` – ${words} (${clock(Date.now() / 1000)})`);
    };
    try {
      const answer = await this.desk.link.call(service, request);
      const result = (answer["result"] ?? answer) as { success?: boolean; successful?: boolean; message?: string; reason?: string };
      const good = result.success ?? result.successful ?? false, why = result.message ?? result.reason ?? "";
      done(good ? "done" : "refused", good ? `done${why ? `: ${why}` : ""}` : `refused: ${why || "no reason given"}`);
      return good;
    } catch (error) {
      done("refused", `not done: ${(error as Error).message}`);
      return false;
    } finally {
      this.refresh();
    }
  }
}

function number(name: string, value: number): object {
  return { name, value: { type: DOUBLE, double_value: value } };
}

function text(name: string, value: string): object {
  return { name, value: { type: STRING, string_value: value } };
}

/** Ask; the answer is no unless somebody says yes. */
function confirm(title: string, words: string): Promise<boolean> {
  const dialog = byId<HTMLDialogElement>("confirm");
  if (dialog.open) return Promise.resolve(false);
  say(byId("confirm-title"), title);
  say(byId("confirm-text"), words);
  dialog.returnValue = "";
  dialog.showModal();
  byId("confirm-no").focus();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
  });
}
