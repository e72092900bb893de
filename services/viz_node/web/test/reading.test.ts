import { describe, expect, it } from "vitest";
import { measure, neighbour, readAt, sampleAt, type Samples } from "../src/scopes/reading";
import { mainFrequency } from "../src/scopes/spectrum";
import { Ring } from "../src/ring";

/** A ring of samples of a function of the time [s]. */
function filled(times: number[], of: (time: number) => number): Ring {
  const ring = new Ring(1, times.length);
  ring.push(times.length, times[0]!, new Float32Array([...times.map((time) => time - times[0]!), ...times.map(of)]));
  return ring;
}

const every = (from: number, to: number, step: number): number[] => Array.from({ length: Math.round((to - from) / step) }, (_, i) => from + i * step);
const columns = new Map([["hand", ["force"]], ["tip", ["force"]]]);
/** An edge of 4 N within a millisecond. */
const edge = (time: number): number => (time < 5.0005 ? 0.4 : 4.4);

describe("a cursor", () => {
  const whole: Samples = { ring: (stream) => filled(every(4, 6, 0.001), (time) => edge(time) + (stream === "tip" ? 10 : 0)), width: 0 };
  // the same by the least and the greatest values of spans of 40 ms, as a long window is drawn from
  const spans: Samples = { ring: () => filled([4.95, 4.97, 4.99, 5.01, 5.03, 5.05], (time) => edge(time - 0.01)), width: 0.04 };

  it("stands at the time of a sample, and reads every curve there", () => {
    const found = readAt(whole, columns, 5.00027, "hand");
    expect(found.time).toBeCloseTo(5, 6);
    expect([...found.values]).toEqual([["hand.force", Math.fround(0.4)], ["tip.force", Math.fround(10.4)]]);
    expect(found.isExact).toBe(true);
  });

  it("keeps what it has read, whatever is drawn afterwards", () => {
    const found = readAt(whole, columns, 5.001, "hand");
    // the next part of the recording has another number there
    expect(readAt(spans, columns, found.time, "hand").values.get("hand.force")).not.toBe(found.values.get("hand.force"));
    expect(found.values.get("hand.force")).toBeCloseTo(4.4, 5);
    // read again among all samples its time gives the same sample and the same number
    expect(readAt(whole, columns, found.time, "hand")).toEqual(found);
    expect(readAt(spans, columns, 5.001, "hand").isExact).toBe(false);
  });

  it("goes on by at least one sample, and stays where there is none", () => {
    const ring = whole.ring("hand")!;
    expect(neighbour(ring, 5, 1)).toBeCloseTo(5.001, 6);
    expect(neighbour(ring, 5, -1)).toBeCloseTo(4.999, 6);
    expect(neighbour(ring, 9, 1)).toBe(9);
    expect(neighbour(undefined, 3, 1)).toBe(3);
  });

  it("reads the sample that is nearest, and none where there is a gap", () => {
    const ring = new Ring(1, 4);
    ring.push(3, 10, new Float32Array([0, 0.001, 0.5, 7, 8, 9]));
    expect(sampleAt(ring, 0, 10.0008, 0.06)[1]).toBe(8);
    expect(sampleAt(ring, 0, 10.25, 0.06)[1]).toBeNaN();
  });
});

describe("between two cursors", () => {
  const swing = (time: number): number => 1 + 2.2 * Math.sin(2 * Math.PI * 0.78 * time) + 0.3 * time;
  const samples: Samples = { ring: () => filled(every(0, 8, 0.001), swing), width: 0 };

  it("the way from peak to peak, the mean and the frequency are measured", () => {
    const found = measure({ ring: () => filled(every(0, 8, 0.001), (time) => swing(time) - 0.3 * time), width: 0 }, "hand", 0, 0, 6.4103);
    expect(found.peakToPeak).toBeCloseTo(4.4, 2);
    expect(found.mean).toBeCloseTo(1, 1);
    expect(found.hertz).toBeCloseTo(0.78, 2);
    // beside a drift, and of no more than three turns
    expect(measure(samples, "hand", 0, 1, 5).hertz / 0.78).toBeCloseTo(1, 1);
  });

  it("spans have a way and neither mean nor frequency, and nothing has none", () => {
    const found = measure({ ...samples, width: 0.02 }, "hand", 0, 1, 5);
    expect(found.peakToPeak).toBeGreaterThan(4);
    expect([found.mean, found.hertz]).toEqual([NaN, NaN]);
    expect(measure(samples, "hand", 0, 20, 30).peakToPeak).toBeNaN();
  });

  it("what does not turn twice, or is noise, has no frequency", () => {
    expect(mainFrequency(every(0, 2, 0.001), every(0, 2, 0.001).map((time) => Math.sin(2 * Math.PI * 0.5 * time)))).toBeNaN();
    expect(mainFrequency([], [])).toBeNaN();
    expect(mainFrequency(every(0, 2, 0.001), every(0, 2, 0.001).map(() => 3))).toBeNaN();
  });

  it.each([0.61, 0.78, 1.5, 3.1, 12, 97])("a sine of %s Hz has its frequency within a hundredth", (hertz) => {
    const times = every(0, 5, 0.001);
    const found = mainFrequency(times, times.map((time) => 3 + Math.sin(2 * Math.PI * hertz * time + 1)));
    expect(Math.abs(found / hertz - 1)).toBeLessThan(0.02);
  });
});
