import assert from "node:assert/strict";
import { test } from "node:test";
import { type Column, Columns } from "../src/columns";
import { curves, positive, Stream } from "../src/stream";

type Row = Column & { t: number };

function rows(columns: Columns, from = -Infinity, to = Infinity): Row[] {
  const all: Row[] = [];
  columns.each(from, to, (t, column) => all.push({ t, ...column }));
  return all;
}

// Numbers without a pattern, the same every time.
function* noise(seed = 1): Generator<number> {
  for (let x = seed; ; ) {
    x = (x * 1103515245 + 12345) % 2147483648;
    yield x / 2147483648 - 0.5;
  }
}

test("every sample lies within the column of its time, and the column's edges are samples", () => {
  const columns = new Columns(600),
    random = noise(),
    samples: [number, number][] = [];
  for (let i = 0; i < 12000; i += 1) {
    const sample: [number, number] = [1.7e9 + i * 0.005, random.next().value!];
    samples.push(sample);
    columns.push(...sample);
  }
  const all = rows(columns);
  assert.ok(all.length >= 300 && all.length <= 600);
  for (const { t, low, high } of all) {
    const inside = samples
      .filter(([s]) => Math.floor(s / columns.width) === Math.round(t / columns.width))
      .map(([, v]) => v);
    assert.equal(low, Math.min(...inside));
    assert.equal(high, Math.max(...inside));
  }
});

test("a column says which of its edges came first, also once two have become one", () => {
  for (const count of [10, 2]) {
    const columns = new Columns(count, count === 10 ? 1 : 0.5);
    for (const [t, v] of [
      [0.1, 1],
      [0.2, 5],
      [0.9, 3],
      [1.1, 5],
      [1.2, 1],
      [1.9, 3],
    ] as const)
      columns.push(t, v);
    assert.deepEqual(
      rows(columns).map((row) => [row.low, row.high, row.rising]),
      [
        [1, 5, true],
        [1, 5, false],
      ],
    );
  }
});

test("columns cover all time at half their number or better, and lose no extreme", () => {
  const columns = new Columns(64),
    random = noise(7);
  let least = Infinity,
    most = -Infinity;
  for (let i = 0; i < 100000; i += 1) {
    const v = random.next().value!,
      t = 1.7e9 + i * 0.013;
    [least, most] = [Math.min(least, v), Math.max(most, v)];
    columns.push(t, v);
    if (i % 9973 === 5000) {
      const all = rows(columns);
      assert.ok(all.length > 30 && all.length <= 64, `${all.length} columns`);
      assert.equal(Math.min(...all.map((row) => row.low)), least);
      assert.equal(Math.max(...all.map((row) => row.high)), most);
      assert.ok(all[0]!.t <= 1.7e9 && all.at(-1)!.t + columns.width >= t);
    }
  }
});

test("what is not a number, and what is older than the first value, is left out", () => {
  const columns = new Columns(10, 1);
  columns.push(0.5, NaN);
  columns.push(1.5, 2);
  columns.push(2.5, Infinity);
  columns.push(0.5, 3);
  assert.deepEqual(
    rows(columns).map((row) => [row.t, row.low]),
    [[1, 2]],
  );
});

test("the last seconds are drawn as they came, a minute as columns of the same samples", () => {
  const stream = new Stream(),
    t0 = 1.7e9;
  for (let i = 0; i < 13000; i += 1) stream.push(t0 + i * 0.005, i, ["a"], [Math.sin(i / 40)]);
  const end = stream.last;
  const [t, v] = curves(stream, ["a"], end - 10, end);
  const drawn = t.filter((time) => time >= end - 10);
  assert.equal(drawn.length, 2001);
  assert.equal(v!.at(-1), Math.sin(12999 / 40));
  const [columns, values] = curves(stream, ["a"], end - 60, end);
  assert.ok(columns.length <= 2402 && columns.length > 1150, `${columns.length}`);
  assert.ok(columns.every((time, i) => i === 0 || time > columns[i - 1]!));
  assert.ok(Math.abs(Math.max(...(values as number[])) - 1) < 1e-3);
});

test("a silence breaks the line", () => {
  const stream = new Stream();
  for (const from of [100, 110])
    for (let i = 0; i < 400; i += 1) stream.push(from + i * 0.005, i, ["a"], [1]);
  for (const to of [112, 150]) {
    const [, v] = curves(stream, ["a"], 95, to);
    assert.equal(v!.filter((value) => value === null).length, 1);
  }
});

test("hours at 200 Hz need no more memory than the first minutes, and all of them are drawn", () => {
  const stream = new Stream(),
    names = ["x[0]", "x[1]"];
  const size = (): number =>
    [...stream.signals.values()].reduce((sum, s) => sum + s.raw.length + s.columns.count, 0);
  let i = 0;
  const run = (seconds: number): void => {
    for (const end = i + seconds * 200; i < end; i += 1)
      stream.push(1.7e9 + i / 200, i, names, [i, -i]);
  };
  run(90);
  const before = size();
  run(2 * 3600);
  assert.equal(size(), before);
  for (const span of [600, 3600, stream.last - stream.first]) {
    const [t, up, down] = curves(stream, names, stream.last - span, stream.last);
    assert.ok(t.length > 600 && t.length < 2500, `${t.length} points of ${span} s`);
    assert.equal(up!.at(-1), i - 1);
    assert.equal(down!.at(-1), 1 - i);
    assert.ok(Math.abs(t[0]! - (stream.last - span)) < 10);
  }
  const all = rows(stream.signals.get("x[0]")!.columns);
  assert.deepEqual([all[0]!.low, all.at(-1)!.high], [0, i - 1]);
});

test("a logarithmic axis shows what is above 0, whatever else there is", () => {
  const curves: [number[], ...(number | null)[][]] = [
    [1, 2, 3],
    [0, 0.5, null],
    [1, -1, 2],
  ];
  assert.deepEqual(positive(curves), [
    [1, 2, 3],
    [null, 0.5, null],
    [1, null, 2],
  ]);
});
