import { expect, it } from "vitest";
import { nearest, ticks, values } from "../gallery/gallery.js";

it("adds differences up", () => expect(values([3, -1, 0, 2], 0.5)).toEqual([1.5, 1, 1, 2]));
it("finds the nearest round trip", () => expect([-3, 12, 13, 900].map((delay) => nearest([0, 5, 10, 15], delay))).toEqual([0, 2, 3, 3]));
it("has round ticks", () => {
  expect(ticks([-60, 20])).toEqual([-60, -40, -20, 0, 20]);
  expect(ticks([-0.05, 0.05])).toEqual([-0.04, -0.02, 0, 0.02, 0.04]);
});
