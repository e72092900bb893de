import { describe, expect, it } from "vitest";
import { BUILT_IN, Layouts, moved, overlaid } from "../src/scopes/layout";
import { axisRange, noiseOf } from "../src/scopes/range";
import { resampled, spectrumOf } from "../src/scopes/spectrum";

describe("a range", () => {
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
