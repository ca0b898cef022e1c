// Numbers and elements.

export function short(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (value !== 0 && (size >= 1e5 || size < 1e-3)) {
    return value.toExponential(2).replace(/\.?0+e/, "e").replace("e+", "e").replace("-", "−").replace("e-", "e−");
  }
  return String(Number(value.toPrecision(4))).replace("-", "−");
}

export function byId<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`no element #${id}`);
  return found as T;
}

/** A new element with text and children; text is never taken for HTML. */
export function make(tag: string, given: { text?: string; class?: string; title?: string; data?: Record<string, string> } = {}, ...children: Node[]): HTMLElement {
  const element = document.createElement(tag);
  if (given.text !== undefined) element.textContent = given.text;
  if (given.class) element.className = given.class;
  if (given.title) element.title = given.title;
  for (const [key, value] of Object.entries(given.data ?? {})) element.dataset[key] = value;
  element.append(...children);
  return element;
}

/** Set the text of an element only if it is another: what does not change is not drawn again. */
export function say(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export function clock(t: number): string {
  const date = new Date(t * 1000), two = (n: number): string => String(n).padStart(2, "0");
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}`;
}

/** The last part of a name: `/rig1/relay_esc` is `relay_esc`. */
export function shortName(name: string): string {
  return name.slice(name.lastIndexOf("/") + 1);
}
