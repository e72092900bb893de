import { expect, it } from "vitest";
import { Remaining, countOf, courseOf, cueOf, directionOf, label, targetAt } from "../../telenano_lab/experiments/web/cue.js";
import { linesIn, range } from "../../telenano_lab/experiments/web/target.js";

const array = (...values: number[]) => ({ dtype: "f8", shape: [values.length], data: new Uint8Array(new Float64Array(values).buffer) });
const cue = (changes = {}) => ({
  id: "c-1",
  stage: "trial",
  title: "",
  text: "",
  remaining_s: 10,
  done: 0,
  total: 6,
  practice: false,
  labels: {},
  quantity: "force",
  band: 1e-9,
  times_s: array(0, 2, 4),
  target: array(0, 10, 6),
  questions: [],
  ...changes,
});

it("follows a target between its corners and holds its ends", () => {
  const course = courseOf(cue());
  expect([-1, 0, 1, 2, 3, 4, 9].map((time) => targetAt(course, time))).toEqual([0, 0, 5, 10, 8, 6, 6]);
  const place = courseOf(cue({ quantity: "place", times_s: array(0, 1), target: array(1, 2, 3, 4) }));
  expect([targetAt(place, 0.5, 0), targetAt(place, 0.5, 1)]).toEqual([2, 3]);
  expect(courseOf(cue({ quantity: "none" }))).toBeUndefined();
  expect(cueOf(undefined)).toBeUndefined();
});

it("counts down between what the server says, and never up for a message that took longer", () => {
  const remaining = new Remaining();
  expect(remaining.take(cue(), 1000)).toBe(true);
  expect(remaining.left(3000)).toBe(8);
  // half a second late
  expect(remaining.take(cue({ remaining_s: 8 }), 3500)).toBe(false);
  expect(remaining.left(3500)).toBe(7.5);
  expect(remaining.shown(3500)).toBe(2.5);
  expect(remaining.take(cue({ id: "c-2", remaining_s: null }), 4000)).toBe(true);
  expect(remaining.left(9000)).toBeNull();
});

it("shows the whole target, with room for its band, on round lines", () => {
  const [low, high] = range(courseOf(cue({ target: array(10e-9, 10e-9, 10e-9) })), 1.5e-9);
  expect(low).toBeLessThan(-2e-9);
  expect(high).toBeGreaterThan(13e-9);
  const lines = linesIn(low, high).map((at) => Math.round(at * 1e9));
  expect(lines).toEqual([0, 5, 10]);
  expect(linesIn(-0.3, 2.2)).toEqual([0, 0.5, 1, 1.5, 2]);
});

it("says its own words in the language of the experiment, and in English without any", () => {
  const german = { language: "de", end_rest: "Weiter", trial: "{number} von {total}" };
  expect([label(cue({ labels: german }), "end_rest"), label(cue({ labels: german }), "submit"), label(undefined, "begin")]).toEqual(["Weiter", "Continue", "Begin"]);
  expect([countOf(cue({ done: 2 })), countOf(cue({ done: 6 })), countOf(cue({ done: 2, labels: german })), countOf(cue({ practice: true }))]).toEqual(["Trial 3 of 6", "Trial 6 of 6", "3 von 6", "Practice"]);
  expect(["en", "ar", "he-IL", "FA", "de-AT"].map(directionOf)).toEqual(["ltr", "rtl", "rtl", "rtl", "ltr"]);
});
