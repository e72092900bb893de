import { describe, expect, it } from "vitest";
import { Playhead } from "../src/playhead";

/** Play frames of 60 a second while samples come in packets of a thirtieth; return the steps between frames [s]. */
function steps(head: Playhead, seconds: number, rate = 1): number[] {
  const places: number[] = [];
  for (let frame = 0; frame < 60 * seconds; frame++) places.push(head.advance((Math.floor(frame / 2) / 30) * rate, (frame * 1000) / 60, rate));
  return places.slice(1).map((place, i) => place - places[i]!);
}

describe("the time up to which curves are drawn", () => {
  it("goes on evenly although samples come in packets", () => {
    const found = steps(new Playhead(), 3).slice(60);
    expect(Math.min(...found)).toBeGreaterThan(0.6 / 60);
    expect(Math.max(...found)).toBeLessThan(1.4 / 60);
  });

  it("stays just behind the newest sample, and never passes it", () => {
    const head = new Playhead();
    for (let frame = 0; frame < 300; frame++) {
      const newest = Math.floor(frame / 2) / 30;
      const at = head.advance(newest, (frame * 1000) / 60, 1);
      expect(at).toBeLessThanOrEqual(newest);
      if (frame > 120) expect(newest - at).toBeLessThan(0.15);
    }
  });

  it("comes to the newest sample when no more come", () => {
    const head = new Playhead();
    steps(head, 2);
    for (let frame = 120; frame < 300; frame++) head.advance(1.9, (frame * 1000) / 60, 1);
    expect(head.at).toBe(1.9);
  });

  it("jumps to where a recording was sought, also backwards, and waits while it pauses", () => {
    const head = new Playhead();
    expect(head.advance(50, 0, 0)).toBe(50);
    expect(head.advance(3, 16, 0)).toBe(3);
    expect(head.advance(3, 32, 0)).toBe(3);
    expect(head.advance(-Infinity, 48, 0)).toBe(-Infinity);
    expect(head.advance(8, 64, 1)).toBeCloseTo(7.95);
  });
});
