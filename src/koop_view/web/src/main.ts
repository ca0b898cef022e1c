// Starts the operator's page.

import { Page } from "./page";
import type { Stream } from "./stream";

const page = new Page();

/** For tests and the console: what is kept of a signal, as it came and as it is drawn. */
const probe = {
  newest: () => page.newest,
  raw: (name: string) => streamOf(name)?.raw(name) ?? { t: [], v: [], step: [] },
  columns: (name: string) => {
    const columns: { t: number[]; low: number[]; high: number[] } = { t: [], low: [], high: [] };
    const stored = streamOf(name)?.signals.get(name)?.columns;
    stored?.each(-Infinity, Infinity, (t, { low, high }) => {
      columns.t.push(t);
      columns.low.push(low);
      columns.high.push(high);
    });
    return columns;
  },
};

function streamOf(name: string): Stream | undefined {
  const streams = [...(page.loop?.streams.values() ?? [])];
  return streams.find((stream) => stream.signals.has(name));
}

declare global {
  interface Window {
    koop: typeof probe;
  }
}
window.koop = probe;
