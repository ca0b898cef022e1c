// Starts the operator's page.

import { Page } from "./page";

const page = new Page();

/** For tests and the console: what is kept of a signal as it came. */
const probe = {
  newest: () => page.newest,
  raw: (name: string) => page.loop?.all.find(({ signals }) => signals.has(name))?.raw(name),
};

declare global {
  interface Window {
    koop: typeof probe;
  }
}
window.koop = probe;
