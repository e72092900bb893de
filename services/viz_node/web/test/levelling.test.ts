import { expect, it } from "vitest";
import { levelled } from "../src/levelling";

const [ROWS, POINTS] = [20, 30];
const filled = new Array<boolean>(ROWS).fill(true);
const made = (height: (row: number, point: number) => number): Float32Array => Float32Array.from({ length: ROWS * POINTS }, (_, i) => height(Math.floor(i / POINTS), i % POINTS));

it("leaves heights as they were measured where nothing is asked for", () => {
  const heights = made((row, point) => row * point);
  expect(levelled(heights, filled, POINTS, "none")).toEqual(heights);
});

it("takes off a plane, and leaves what stands on it", () => {
  const bump = (row: number, point: number): number => (row === 10 && point === 15 ? 5 : 0);
  const found = levelled(made((row, point) => 3 + 0.2 * row - 0.1 * point + bump(row, point)), filled, POINTS, "plane");
  expect(found[10 * POINTS + 15]! - found[0]!).toBeCloseTo(5, 1);
  expect(Math.abs(found[POINTS - 1]! - found[0]!)).toBeLessThan(0.05);
});

it("takes the median or the slope off each line", () => {
  const heights = made((row, point) => row * 2 + 0.5 * point);
  const medians = levelled(heights, filled, POINTS, "lines");
  expect(medians[7 * POINTS]).toBeCloseTo(medians[0]!, 5);
  expect(Math.max(...levelled(heights, filled, POINTS, "slopes").map(Math.abs))).toBeLessThan(1e-4);
});

it("does not touch lines that were not measured", () => {
  const partly = filled.map((_, row) => row < 5);
  const heights = made((row) => (row < 5 ? row : 100));
  const found = levelled(heights, partly, POINTS, "plane");
  expect(found[6 * POINTS]).toBe(100);
  expect(found[2 * POINTS]).toBeCloseTo(0, 4);
});
