// Elements of the page.

export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no element #${id}`);
  return element as T;
}

interface Content {
  text?: string;
  class?: string;
  title?: string;
  data?: Record<string, string>;
}

/** A new element with text and children; text is never taken for HTML. */
export function make(tag: string, content: Content = {}, ...children: Node[]): HTMLElement {
  const element = document.createElement(tag);
  if (content.text !== undefined) element.textContent = content.text;
  if (content.class) element.className = content.class;
  if (content.title) element.title = content.title;
  Object.assign(element.dataset, content.data);
  element.append(...children);
  return element;
}

/** Change a text only if it is another one: the browser draws less. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Change children only if they are others: what is selected or pointed at stays so. */
export function setChildren(element: Element, children: HTMLElement[]): void {
  const html = children.map((child) => child.outerHTML).join("");
  if (element.innerHTML !== html) element.replaceChildren(...children);
}

/** Offer values in a selector; what is offered already stays, and what is chosen of it. */
export function setOptions(select: HTMLSelectElement, values: readonly string[]): void {
  if (Array.from(select.options, ({ value }) => value).join() === values.join()) return;
  select.replaceChildren(...values.map((value) => new Option(value, value)));
}
