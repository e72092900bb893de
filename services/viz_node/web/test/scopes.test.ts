import { describe, expect, it } from "vitest";
import { BUILT_IN, Layouts, moved, overlaid } from "../src/scopes/layout";
import { axisRange, extentOf, heldAxis, isNothing, noiseOf, roundRange, type HeldAxis } from "../src/scopes/range";
import { resampled, spectrumOf } from "../src/scopes/spectrum";

describe("a range", () => {
  it("is of nothing where all values are less than the floor, or there are none", () => {
    expect([isNothing(-0.01, 0.01, 0.04), isNothing(0, 0, 0.04), isNothing(null, null, 0.04)]).toEqual([true, true, true]);
    expect([isNothing(-0.01, 0.03, 0.04), isNothing(2, 2.01, 0.04)]).toEqual([false, false]);
  });

  it("is not smaller than the noise, so that noise does not look like an event", () => {
    const [low, high] = axisRange(-1e-5, 1e-5, 0.5);
    expect(high - low).toBeGreaterThan(0.5);
    expect(low).toBeCloseTo(-high);
    expect(axisRange(0, 10, 0.5)[1]).toBeGreaterThan(10);
    expect(axisRange(null, null, 0.5)).toEqual([-0.25, 0.25]);
  });

  it("knows noise from what moves slowly", () => {
    let seed = 1;
    const random = (): number => (seed = (seed * 16807) % 2147483647) / 2147483647 - 0.5;
    // uniform from -0.5 to 0.5: its standard deviation is 0.29
    const noisy = Array.from({ length: 4000 }, (_, i) => Math.sin(i / 500) * 100 + random());
    expect(noiseOf(noisy)).toBeGreaterThan(0.15);
    expect(noiseOf(noisy)).toBeLessThan(0.6);
    expect(noiseOf(noisy.map((_, i) => Math.sin(i / 500)))).toBeLessThan(1e-4);
  });
});

describe("an axis that holds still", () => {
  it("has round ends that are not much further apart than what it shows", () => {
    let seed = 3;
    const random = (): number => (seed = (seed * 16807) % 2147483647) / 2147483647;
    for (let i = 0; i < 2000; i++) {
      const low = (random() - 0.5) * 10 ** (6 * random() - 3);
      const high = low + 10 ** (6 * random() - 3);
      const [from, to] = roundRange([low, high]);
      expect(from).toBeLessThanOrEqual(low + 1e-9 * (high - low));
      expect(to).toBeGreaterThanOrEqual(high - 1e-9 * (high - low));
      expect(to - from).toBeLessThan(1.7 * (high - low));
    }
  });

  it("grows at once and on one side, and shrinks only when it was much too large for a while", () => {
    let axis: HeldAxis | undefined = heldAxis(undefined, [0, 1], 0);
    const range = (wanted: [number, number], now: number): [number, number] => (axis = heldAxis(axis, wanted, now)).range;
    expect(axis!.range).toEqual([0, 1]);
    expect(range([0.1, 0.9], 10)).toEqual([0, 1]);
    // a little more than it shows moves one end, by no more than is needed
    const grown = range([0, 1.1], 20);
    expect(grown[0]).toBe(0);
    expect(grown[1]).toBeGreaterThanOrEqual(1.1);
    expect(grown[1]).toBeLessThan(1.4);
    expect(range([0, 0.2], 30)).toEqual(grown);
    expect(range([0, 0.2], 3000)).toEqual(grown);
    expect(range([0, 0.2], 4100)[1]).toBeLessThan(0.4);
    // a short return to what it showed begins the wait anew
    axis = { range: [0, 1], smallerSince: undefined };
    range([0, 0.2], 0);
    range([0, 0.9], 2000);
    expect(range([0, 0.2], 4500)).toEqual([0, 1]);
  });

  it("does not breathe with a course that swings", () => {
    let axis: HeldAxis | undefined;
    const ranges = new Set<string>();
    for (let now = 0; now < 60_000; now += 50) {
      const top = 2 + 0.1 * Math.sin(now / 300);
      axis = heldAxis(axis, [0, top], now);
      ranges.add(axis.range.join());
    }
    expect(ranges.size).toBeLessThanOrEqual(2);
  });

  it("leaves out how the tip is placed and withdrawn, and shows it where there is nothing else", () => {
    const points = [110, 100, 60, 20, 10, 9, 9, 8];
    expect(extentOf(points, [0, 0, 0, 1, 1, 1, 1, 1])).toEqual([8, 10]);
    expect(extentOf(points, [0, 0, 0, 0, 0, 0, 0, 0])).toEqual([8, 110]);
    expect(extentOf(points)).toEqual([8, 110]);
    expect(extentOf([null, undefined], [1, 1])).toBeUndefined();
  });
});

describe("a spectrum", () => {
  it("has the amplitude of a sine at its frequency", () => {
    const values = Array.from({ length: 1024 }, (_, i) => 5 + 2 * Math.sin((2 * Math.PI * 64 * i) / 1024));
    const { hertz, amplitude } = spectrumOf(values, 1000);
    const peak = amplitude.indexOf(Math.max(...amplitude));
    expect(hertz[peak]).toBeCloseTo(62.5);
    expect(amplitude[peak]).toBeCloseTo(2, 5);
    expect(amplitude[peak + 10]).toBeLessThan(1e-9);
  });

  it("comes of samples that are not even", () => {
    expect([...resampled([0, 0.5, 0.6], [1, 2, 3], 0, 1, 4)]).toEqual([1, 1, 2, 3]);
    expect(spectrumOf([1, 2, 3], 10).hertz).toEqual([]);
  });
});

describe("layouts", () => {
  const kept = new Map<string, string>();
  const storage = { getItem: (key: string) => kept.get(key) ?? null, setItem: (key: string, text: string) => void kept.set(key, text) };

  it("are saved, found again, and removed", () => {
    new Layouts(() => storage).save("mine", BUILT_IN["Touch"]!);
    const layouts = new Layouts(() => storage);
    expect(layouts.names).toContain("mine");
    expect(layouts.get("mine")).toEqual(BUILT_IN["Touch"]);
    layouts.remove("mine");
    expect(layouts.names).not.toContain("mine");
    expect(layouts.get("mine")).toEqual(BUILT_IN["Loop"]);
  });

  it("are the usual ones in a browser that keeps nothing, or rubbish", () => {
    const broken = { getItem: () => "{", setItem: () => { throw new Error("no"); } };
    expect(new Layouts(() => broken).now.name).toBe("Loop");
    expect(() => new Layouts(() => broken).keep("Loop", [])).not.toThrow();
  });

  it("have scopes that move and that are drawn over one another", () => {
    expect(moved(["a", "b", "c"], 2, 0)).toEqual(["c", "a", "b"]);
    expect(moved(["a", "b", "c"], 0, 2)).toEqual(["b", "a", "c"]);
    const specs = overlaid(BUILT_IN["Loop"]!, 1, 0);
    expect(specs).toHaveLength(BUILT_IN["Loop"]!.length - 1);
    expect(specs[0]!.curves.map((curve) => curve.column)).toEqual(["force", "tip_force", "position", "reference"]);
  });
});
