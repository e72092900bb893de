import { readFileSync } from "node:fs";
import { expect, it } from "vitest";
import { chartsOf, ends, pieces, type LineData } from "../src/linecurves";

const data = JSON.parse(readFileSync(new URL("../gallery/networks.json", import.meta.url), "utf-8")) as LineData;

it("has an axis around its numbers, and of a logarithm none that is not above zero", () => {
  expect(ends([3, null, -1], false)).toEqual([-1, 3]);
  expect(ends([0, 20, 5], true)).toEqual([5, 20]);
  expect(ends([4, 4], true)).toEqual([2, 8]);
  expect(ends([null], true)).toEqual([1, 10]);
});

it("goes from corner to corner, and is broken where there is no number", () => {
  expect(pieces([0, 1, 2], [0, 5, 10], [0, 2], [0, 10], false, false)).toEqual(["44.0,84.0 109.0,45.0 174.0,6.0"]);
  expect(pieces([1, 10, 100], [1, 10, 100], [1, 100], [1, 100], true, true)).toEqual(["44.0,84.0 109.0,45.0 174.0,6.0"]);
  expect(pieces([0, 1, 2, 3, 4], [1, 1, null, 1, 1], [0, 4], [0, 1], false, false)).toHaveLength(2);
});

it("draws what was measured: memory and age tell a line from its twin, whose delays are the same", () => {
  const [line, twin] = ["starlink_driving", "starlink_driving_no_memory"].map((name) => data.networks[name]!);
  const at = (values: number[], share: number): number => values[data.slower.indexOf(share)]!;
  expect(at(twin!.delay_ms, 0.5) / at(line!.delay_ms, 0.5)).toBeCloseTo(1, 1);
  expect(line!.memory[1][0]).toBeGreaterThan(0.9);
  expect(Math.abs(twin!.memory[1][0]!)).toBeLessThan(0.1);
  expect(at(line!.age_ms, 0.01)).toBeGreaterThan(1.3 * at(twin!.age_ms, 0.01));
  for (const curves of Object.values(data.networks)) {
    const charts = chartsOf(curves, data.slower);
    expect(charts).toHaveLength(4);
    for (const { x, ys } of charts) for (const y of ys) expect(y).toHaveLength(x.length);
  }
});
