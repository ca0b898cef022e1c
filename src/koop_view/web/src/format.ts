// Numbers, times and names as they are shown.

export function short(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (value !== 0 && (size >= 1e5 || size < 1e-3)) {
    const text = value.toExponential(2).replace(/\.?0+e/, "e");
    return text.replace("e+", "e").replaceAll("-", "−");
  }
  return String(Number(value.toPrecision(4))).replace("-", "−");
}

/** Values along an axis, with more digits where they are alike; null: no text. */
export function labels(values: readonly (number | null)[]): string[] {
  const shown = values.filter((value) => value !== null);
  const alike = new Set(shown.map(short)).size < shown.length;
  const text = alike ? (v: number) => String(Number(v.toPrecision(9))).replace("-", "−") : short;
  return values.map((value) => (value === null ? "" : text(value)));
}

export function clock(t: number): string {
  return new Date(t * 1000).toTimeString().slice(0, 8);
}

/** The last part of a name: `/rig1/relay_esc` is `relay_esc`. */
export function shortName(name: string): string {
  return name.slice(name.lastIndexOf("/") + 1);
}

/** The values of knobs in a report, which has those of several in brackets. */
export function readKnobs(text = ""): number[] {
  return text ? text.replace(/[[\]]/g, "").split(",").map(Number) : [];
}

/** Theta of each knob, with its limits where they are known. */
export function formatKnobs(
  theta: readonly number[] = [],
  limits: readonly [number, number][] = [],
): string {
  const each = theta.map((value, i) => {
    const ends = limits[i];
    return short(value) + (ends ? ` in [${short(ends[0])}, ${short(ends[1])}]` : "");
  });
  return each.length === 1 ? each[0]! : each.length ? `(${each.join(", ")})` : "–";
}
