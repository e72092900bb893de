import { describe, expect, it } from "vitest";
import { countdown } from "../src/countdown";
import { creepText } from "../src/creep";
import { arrowShare, DEEPEST_NM, GAP_TICKS, gapShare, gapWords, HIGHEST_NM, limitWords } from "../src/gapscale";

describe("the scale of the gap", () => {
  it("shows 0.1 nm as well as 100 nm, in order and without a step, and keeps what lies beyond at its edge", () => {
    let before = -Infinity;
    for (let nm = -DEEPEST_NM; nm <= HIGHEST_NM; nm += 0.05) {
      const share = gapShare(nm);
      expect(share).toBeGreaterThan(before - 1e-12);
      before = share;
    }
    expect([gapShare(-DEEPEST_NM), gapShare(HIGHEST_NM), gapShare(1e4), gapShare(-1e4)]).toEqual([0, 1, 1, 0]);
    // a tenth of a nanometre, and each factor of ten above it, is seen: more than a fortieth of the picture
    const up = GAP_TICKS.filter((nm) => nm >= 0).reverse().map(gapShare);
    up.slice(1).forEach((share, i) => expect(share - up[i]!).toBeGreaterThan(0.025));
  });

  it("has an arrow for each force that is felt, longer for a larger one, up where the sample pushes", () => {
    expect(arrowShare(NaN) + arrowShare(0.01)).toBe(0);
    const forces = [0.06, 0.2, 1, 5, 23, 90, 1e4];
    const lengths = forces.map(arrowShare);
    lengths.slice(1).forEach((length, i) => expect(length).toBeGreaterThanOrEqual(lengths[i]!));
    expect(lengths.at(-1)).toBe(1);
    for (const force of forces) expect(arrowShare(-force)).toBe(-arrowShare(force));
  });

  it("has its longest arrow at the limit of the guard, whatever that is, and says the limit where one is known", () => {
    for (const limit of [1, 20, 100, 500, 2000]) {
      expect(arrowShare(limit, limit)).toBeCloseTo(1, 9);
      expect(arrowShare(10 * limit, limit)).toBe(1);
      expect(arrowShare(limit / 2, limit)).toBeLessThan(1);
    }
    expect([arrowShare(100, 0), arrowShare(100, NaN)]).toEqual([1, 1]);
    expect([200.00000000000003, 99.5, NaN, Infinity, 0].map(limitWords)).toEqual(["limit 200 nN", "limit 99.5 nN", "", "", ""]);
  });

  it("says distance, force and speed with rounded units, and 0 for what is none", () => {
    expect(gapWords(9.7, -0.1, -15.2, false, false)).toEqual({ gap: "9.7 nm above the sample", force: "0.1 nN, the sample pulls", speed: "15 nm/s towards the sample" });
    expect(gapWords(-1.34, 22.97, 1.393e-5, true, false)).toEqual({ gap: "1.3 nm into the sample", force: "23 nN, the sample pushes", speed: "rests" });
    expect(gapWords(0.6, -12.5, 0, false, true).gap).toBe("0.6 nm above, held by a water bridge");
    expect(gapWords(110, 1.4e-5, 0, false, false)).toEqual({ gap: "110 nm above the sample, off this scale", force: "no force", speed: "rests" });
    expect(gapWords(NaN, NaN, NaN, false, false)).toEqual({ gap: "distance not known", force: "no force", speed: "rests" });
  });
});

describe("a countdown", () => {
  it("goes from its length to 0 and no further", () => {
    expect(countdown(1000, 2.2, 1000)).toEqual({ left_s: 2.2, share: 0, text: "2.2 s left" });
    expect(countdown(1000, 2, 2000)).toEqual({ left_s: 1, share: 0.5, text: "1.0 s left" });
    expect(countdown(1000, 2, 9000)).toEqual({ left_s: 0, share: 1, text: "arriving" });
    // a clock that is set back adds no time
    expect(countdown(1000, 2, 0).left_s).toBe(2);
    expect(countdown(1000, 0, 1000).share).toBe(1);
  });
});

describe("a hand that nobody holds", () => {
  it("says why it moves, and is silent where it rests or somebody presses it", () => {
    // 0.35 mm in 100 s, as a tip at 10 nm draws it
    expect(creepText(14e-6, 4, 0, -0.002)).toBe("Nobody holds the hand: the tip draws it down with 2.0 mN, 0.21 mm a minute. Hold it, and it stays");
    expect(creepText(-0.02, 4, 0, 1.2)).toBe("Nobody holds the hand: the sample pushes it up with 1.20 N, 5.0 mm a second. Hold it, and it stays");
    expect(creepText(14e-6, 4, 0, 0)).toMatch(/drifts down by itself/);
    expect(creepText(14e-6, 4, 0.5, -0.002)).toBe("");
    expect(creepText(1e-7, 4, 0, -0.002)).toBe("");
    expect(creepText(NaN, 4, 0, 0)).toBe("");
    expect(creepText(1e-3, 0, 0, 0)).toBe("");
  });
});
