import { expect, test } from "vitest";
import { Pressing } from "../src/pressing";
import { bannersOf } from "../src/state";
import { Store } from "../src/store";

const STEP_MS = 50;

/** What is said at the end of some time, and whether anything was said before [ms]; forces by the time [N]. */
function over(ms: number, meant: (at: number) => number | undefined, pressed: (at: number) => number, newest = (at: number) => at / 1e3, way_s = NaN): { said: string; ever: boolean } {
  const pressing = new Pressing();
  let [said, ever] = ["", false];
  for (let at = 0; at <= ms; at += STEP_MS) {
    said = pressing.look(at, meant(at), pressed(at), newest(at), way_s);
    ever ||= said !== "";
  }
  return { said, ever };
}

const QUIET = { said: "", ever: false };

test("a hand that presses as the page means, a little later, is not spoken of", () => {
  expect(over(5000, () => 2, () => 2)).toEqual(QUIET);
  // taken hold of with a whole force at once, which arrives after 0.3 s
  expect(over(5000, () => 2, (at) => (at < 300 ? 0 : 2))).toEqual(QUIET);
  // dragged, with noise, and 0.25 s behind
  expect(over(5000, (at) => Math.min(3, at / 500), (at) => Math.max(0, Math.min(3, (at - 250) / 500)) + 0.1 * (-1) ** (at / STEP_MS))).toEqual(QUIET);
  // the loop swings, and what is seen of it is late
  const swing = (at: number): number => 2 * Math.sin((2 * Math.PI * at) / 1000);
  expect(over(20_000, swing, (at) => swing(at - 200))).toEqual(QUIET);
  // a long way there and back is no disagreement
  expect(over(5000, (at) => (at < 2000 ? 3 : 0), (at) => (at < 3100 ? 3 : 0), undefined, 1.2)).toEqual(QUIET);
});

test("a hand that pressed with nothing, or with gaps, is spoken of, and so is one of which nothing is heard", () => {
  expect(over(1500, () => 2, () => 0).said).toBe("this page asked for 2.0 N, and the hand pressed with 0.0 N");
  // the other way round as well: it presses, and the page means to pull
  expect(over(1500, () => -1, () => 1).said).toBe("this page asked for -1.0 N, and the hand pressed with 1.0 N");
  expect(over(3000, () => 2, (at) => (at % 400 < 150 && at > 1200 ? 0 : 2)).ever).toBe(true);
  // what is said is how they were apart, also in a moment in which they are not
  expect(over(2750, () => 2, (at) => (at % 400 < 150 && at > 1200 ? 0 : 2)).said).toBe("this page asked for 2.0 N, and the hand pressed with 0.0 N");
  expect(over(3000, () => 2, () => 2, (at) => Math.min(at, 1000) / 1e3).said).toBe("this page asked for 2.0 N, and no data came from the hand");
  expect(over(1500, () => 2, () => NaN).said).toMatch(/no data came from the hand/);
});

test("it can be read for a while, and ends at once when the hand is let go", () => {
  const back = (ms: number): string => over(ms, () => 2, (at) => (at < 1500 ? 0 : 2)).said;
  expect(back(3000)).not.toBe("");
  expect(back(6000)).toBe("");
  expect(over(1600, (at) => (at < 1550 ? 2 : undefined), () => 0).said).toBe("");
});

test("the banner says it in red, before what else is so", () => {
  const store = new Store();
  store.take({ k: "tick", nodes: { "haptic_node@master": { state: "running" } as never } });
  store.apart = "this page asked for 2.0 N, and the hand pressed with 0.0 N";
  expect(bannersOf(store, "open", "")[0]).toEqual(["bad", "FORCE DIFFERS: this page asked for 2.0 N, and the hand pressed with 0.0 N"]);
});
