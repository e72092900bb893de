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

it("knows the height at a place to the nearest point, and the section through it", () => {
  const surface = new Surface();
  for (let i = 0; i < LINES; i++) surface.add(line(i));
  expect(surface.heightAt(50, 100)).toBeCloseTo(LINES - 1);
  expect(surface.heightAt(-500, -500)).toBeCloseTo(0);
  const section = surface.section(0);
  expect(section.distance.at(-1)).toBeCloseTo(100);
  expect(new Set(section.height)).toEqual(new Set([0]));
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
