import { describe, expect, it } from "vitest";
import { grid, minMax, Ring } from "../src/ring";

/** Samples at 1 kHz from t0 on, of one column. */
function ring(values: number[], t0 = 0, capacity = 1000): Ring {
  const found = new Ring(1, capacity);
  const times = values.map((_, i) => i * 1e-3);
  found.push(values.length, t0, Float32Array.from([...times, ...values]));
  return found;
}

describe("Ring", () => {
  it("keeps the newest samples in the order of time", () => {
    const found = new Ring(2, 4);
    for (let i = 0; i < 3; i++) found.push(2, i, Float32Array.from([0, 0.5, i, i + 0.5, 10 * i, 10 * i + 5]));
    expect(Array.from({ length: found.length }, (_, i) => found.time(i))).toEqual([1, 1.5, 2, 2.5]);
    expect(Array.from({ length: found.length }, (_, i) => found.value(1, i))).toEqual([10, 15, 20, 25]);
    expect(found.indexAt(1.6)).toBe(2);
    expect(found.newest).toBe(2.5);
  });

  it("takes more at once than it can hold", () => {
    const found = ring(Array.from({ length: 50 }, (_, i) => i), 0, 8);
    expect(found.length).toBe(8);
    expect(found.value(0, 0)).toBe(42);
  });

  it("begins anew where time goes back, as when a publisher was restarted", () => {
    const found = ring([1, 2, 3], 100);
    found.push(1, 5, Float32Array.from([0, 9]));
    expect(found.length).toBe(1);
    expect(found.last(0)).toBe(9);
  });

  it("refuses numbers that are not samples of its columns", () => {
    expect(() => new Ring(2, 4).push(1, 0, new Float32Array(2))).toThrow("2 numbers are not 1 samples");
  });
});

describe("minMax", () => {
  it("loses no spike, however many samples a pixel has", () => {
    for (let spike = 0; spike < 1000; spike += 37) {
      const values = Array.from({ length: 1000 }, (_, i) => (i === spike ? -7 : Math.sin(i / 50)));
      expect(Math.min(...(minMax(ring(values), 0, 0, 1, 40, 0.05) as number[]))).toBe(-7);
    }
  });

  it("gives least and greatest in the order in which they came", () => {
    expect(minMax(ring([1, 5, 2, 0, 9, 3]), 0, 0, 6e-3, 1, 1)).toEqual([0, 9]);
    expect(minMax(ring([9, 5, 2, 0, 1, 3]), 0, 0, 6e-3, 1, 1)).toEqual([9, 0]);
  });

  it("joins samples further apart than a pixel and breaks the curve at a gap", () => {
    const found = new Ring(1, 100);
    found.push(2, 0, Float32Array.from([0, 0.0105, 1, 2]));
    found.push(1, 0.5, Float32Array.from([0, 3]));
    const points = minMax(found, 0, 0, 0.6, 60, 0.05);
    expect(points[1]).toBe(1);
    expect(points.slice(4, 50).every((point) => point === null)).toBe(true);
    expect(points[100]).toBe(3);
    // nothing came since, and not for long enough to be a gap before 0.55 s: the end is one
    expect(points.at(-1)).toBe(null);
    expect(minMax(found, 0, 0, 0.02, 20, 0.05)[10]).toBeUndefined();
  });

  it("draws a gap where a value is not known", () => {
    const points = minMax(ring([1, NaN, 3, 4]), 0, 0, 4e-3, 4, 1);
    expect(points.slice(2, 4)).toEqual([null, null]);
    expect(points[4]).toBe(3);
  });

  it("has two places in each bucket of the grid", () => {
    expect(Array.from(grid(0, 1, 2))).toEqual([0.125, 0.375, 0.625, 0.875]);
  });
});
