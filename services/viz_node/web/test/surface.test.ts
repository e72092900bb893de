import { expect, it } from "vitest";
import type { BufferAttribute } from "three";
import type { Line } from "../src/protocol";
import { Surface } from "../src/surface";

const POINTS = 64;
const LINES = 32;

/** A line of an image of 100 nm, whose height is its number [nm]. */
function line(number: number, changes: Partial<Line> = {}): Line {
  const y = (number / (LINES - 1)) * 100e-9;
  const heights = new Float64Array(POINTS).fill(number * 1e-9);
  return {
    line: number,
    lines: LINES,
    direction: "trace",
    start_m: [0, y, 0],
    end_m: [100e-9, y, 0],
    height: { dtype: "f8", shape: [POINTS], data: new Uint8Array(heights.buffer) },
    ...changes,
  };
}

it("grows line by line, and sends only the new line to the graphics processor", () => {
  const surface = new Surface();
  surface.add(line(0));
  expect(surface.isEmpty).toBe(true);
  surface.add(line(1));
  expect(surface.isEmpty).toBe(false);
  const position = surface.mesh.geometry.getAttribute("position") as BufferAttribute;
  position.clearUpdateRanges();
  surface.add(line(2));
  expect(position.updateRanges).toEqual([{ start: 2 * POINTS * 3, count: POINTS * 3 }]);
  expect([surface.least, surface.greatest]).toEqual([0, expect.closeTo(2)]);
});

it("knows the height at a place to the nearest point", () => {
  const surface = new Surface();
  for (let i = 0; i < LINES; i++) surface.add(line(i));
  expect(surface.heightAt(50, 100)).toBeCloseTo(LINES - 1);
  expect(surface.heightAt(-500, -500)).toBeCloseTo(0);
});

it("picks the measured point itself, with its numbers and its own coordinates", () => {
  const surface = new Surface();
  expect(surface.nearest(0, 0)).toBeUndefined();
  for (let i = 0; i < LINES; i++) surface.add(line(i));
  const step = 100 / (POINTS - 1);
  const found = surface.nearest(10.3 * step, 100)!;
  expect([found.line, found.point]).toEqual([LINES - 1, 10]);
  expect(found.at[0]).toBeCloseTo(10 * step, 4);
  expect(found.at[2]).toBe(LINES - 1);
});

it("has the profile of any straight line, with gaps where nothing was measured", () => {
  const surface = new Surface();
  for (let i = 0; i < LINES - 1; i++) surface.add(line(i));
  // the height is the number of the line: along the image it is even, across it a ramp
  expect(surface.profile([0, 0], [100, 0], 5).height).toEqual([0, 0, 0, 0, 0]);
  const step = 100 / (LINES - 1);
  const ramp = surface.profile([50, 0], [50, 100], 2 * LINES - 1);
  expect(ramp.distance.at(-1)).toBeCloseTo(100);
  ramp.height.slice(0, 2 * LINES - 3).forEach((height, i) => expect(height).toBeCloseTo(i / 2, 4));
  expect(ramp.height.slice(2 * LINES - 2).every(Number.isNaN)).toBe(true);
  expect(surface.profile([-20, 3.5 * step], [-10, 3.5 * step], 2).height).toEqual([NaN, NaN]);
});

it("knows places in an image whose fast axis is turned", () => {
  const surface = new Surface();
  const [c, s] = [Math.cos(0.5) * 100e-9, Math.sin(0.5) * 100e-9];
  for (let i = 0; i < LINES; i++) {
    const share = i / (LINES - 1);
    surface.add(line(i, { start_m: [-s * share, c * share, 0], end_m: [c - s * share, s + c * share, 0] }));
  }
  const [middle, across] = [[(c - s) / 2, (c + s) / 2], [-s / 2, c / 2]].map((place) => place.map((m) => m * 1e9));
  expect(surface.profile(middle as [number, number], [middle![0]! + across![0]!, middle![1]! + across![1]!], 3).height[2]).toBeCloseTo(LINES - 1, 3);
  expect([(POINTS - 2) / 2, POINTS / 2]).toContain(surface.nearest(middle![0]!, middle![1]!)?.point);
});

it("joins only lines that were measured: where one is missing there is a hole", () => {
  const surface = new Surface();
  for (const i of [0, 1, 4, 5]) surface.add(line(i));
  const triangles = surface.mesh.geometry.getIndex()!.array;
  const used = [...triangles].filter((vertex) => vertex >= 2 * POINTS && vertex < 4 * POINTS);
  expect(used).toEqual([]);
});

it("takes no line that does not fit an image", () => {
  const surface = new Surface();
  surface.add(line(40));
  surface.add(line(0, { direction: "retrace" }));
  surface.add(line(1, { height: { dtype: "f8", shape: [0], data: new Uint8Array() } }));
  expect(surface.isEmpty).toBe(true);
});

it("begins anew when an image of another size begins", () => {
  const surface = new Surface();
  for (let i = 0; i < LINES; i++) surface.add(line(i));
  surface.add(line(0, { lines: 8 }));
  expect(surface.isEmpty).toBe(true);
});

it("knows its whole extent from its first lines", () => {
  const surface = new Surface();
  surface.add(line(0));
  expect(surface.extent).toBeUndefined();
  surface.add(line(1));
  const extent = surface.extent!;
  for (const [key, value] of Object.entries({ x: 50, y: 50, width: 100, depth: 100 })) expect(extent[key as "x"]).toBeCloseTo(value, 3);
});
