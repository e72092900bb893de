import { expect, it } from "vitest";
import { Pace } from "../src/pace";

/** Return in which of the frames, this far apart [ms], something is drawn. */
function drawn(period: number, share: number, frames = 200): number[] {
  const pace = new Pace(share);
  const found: number[] = [];
  for (let frame = 0; frame < frames; frame++) {
    if (!pace.isDue(frame * period)) continue;
    pace.drawn(frame * period);
    found.push(frame);
  }
  return found;
}

it("draws in each frame where frames are quick", () => {
  expect(drawn(16.7, 6).length).toBe(200);
});

it("draws in one of several where frames are slow, and never gives up", () => {
  const late = drawn(120, 6).filter((frame) => frame > 50);
  expect(late.length).toBeLessThan(30);
  const steps = late.slice(1).map((frame, i) => frame - late[i]!);
  expect(Math.max(...steps)).toBeLessThanOrEqual(7);
});

it("draws at the old pace again when frames become quick", () => {
  const pace = new Pace(6);
  for (let now = 0; now < 6000; now += 200) if (pace.isDue(now)) pace.drawn(now);
  let missed = 0;
  for (let now = 6000; now < 8000; now += 16) if (!pace.isDue(now)) missed++;
  expect(missed).toBeLessThan(40);
});
