import { describe, expect, test } from "vitest";
import type { NodeFacts, StreamData } from "../src/protocol";
import { bannersOf, oldPart, oldWords } from "../src/state";
import { Store } from "../src/store";

const facts: NodeFacts = { state: "running", uptime_s: 1, rate_hz: 1000, overruns: 0, cpu_percent: 1, memory_bytes: 1, replay: false, lateness_p99_s: 0, lost: 0, rejected: 0, beat: 0 };
const STREAMS = [
  { name: "hand", topic: "haptic/state", columns: [{ name: "position", unit: "m", about: "" }] },
  { name: "tip", topic: "afm/state", columns: [{ name: "separation", unit: "m", about: "" }] },
];

/** A live rig at the time that the server has said [s]; its clock is 1000 s ahead of that of the page, and 500 s behind that of the rig. */
function live(): Store {
  const store = new Store();
  store.begin({ k: "snapshot", at_s: 1000, role: "operator", commands: true, hand: true, streams: STREAMS, forms: {}, source: { kind: "live", name: "" } });
  return store;
}

/** One sample of a stream at a time of the server [s]. */
const sample = (at_s: number, value: number): StreamData => ({ n: 1, t0: at_s + 500, data: new Uint8Array(Float32Array.of(0, value).buffer) });
const both = (at_s: number, value = at_s): Record<string, StreamData> => ({ hand: sample(at_s, value), tip: sample(at_s, value) });

describe("a lost node", () => {
  test("is one of which the server has had nothing for a second", () => {
    const store = live();
    for (let at_s = 1000; at_s < 1003; at_s += 0.5) {
      store.take({ k: "tick", at_s, nodes: { "afm_node@slave": facts, "console@master": facts } });
      expect(store.lost()).toEqual([]);
    }
    store.take({ k: "tick", at_s: 1003.5 });
    expect(store.lost()).toEqual(["afm_node@slave"]);
    store.take({ k: "tick", at_s: 1003.6, nodes: { "afm_node@slave": facts } });
    expect(store.lost()).toEqual([]);
  });

  test("is not one that said farewell, and a recording has none", () => {
    const store = live();
    store.take({ k: "tick", at_s: 1000, nodes: { "recorder@master": { ...facts, state: "ended" }, "afm_node@slave": facts } });
    store.take({ k: "tick", at_s: 1002 });
    expect(store.lost()).toEqual(["afm_node@slave"]);
    store.take({ k: "tick", source: { kind: "recording", name: "session.mcap" } });
    expect(store.lost()).toEqual([]);
  });

  test("is not invented by a page whose line is silent, or that stood still: it blames its line", () => {
    const store = live();
    store.take({ k: "tick", at_s: 1000, nodes: { "afm_node@slave": facts, "haptic_node@master": facts }, streams: both(1000) }, 0);
    store.look(5000, 5000);
    expect(store.lost()).toEqual([]);
    expect(bannersOf(store, "open", "")).toEqual([["bad", "NOT CONNECTED: this page has heard nothing for 5.0 s"]]);
    expect(oldWords(store)).toBe("this page has heard nothing for 5.0 s");
  });
});

describe("the age of what is shown", () => {
  /** Let frames come 30 times a second for a while, each so much later than it was sent [ms]. */
  function run(store: Store, from_s: number, to_s: number, late: (at_s: number) => number, more: (at_s: number) => Record<string, StreamData> = both): void {
    for (let at_s = from_s; at_s < to_s; at_s += 1 / 30) store.take({ k: "tick", at_s: 1000 + at_s, streams: more(1000 + at_s) }, 1e3 * at_s + late(at_s));
  }

  test("is none while frames come, however far apart the clocks are", () => {
    const store = live();
    run(store, 0, 10, (at_s) => 20 + 10 * Math.sin(at_s));
    store.look(10_000, 10_000);
    expect(store.isPictureOld).toBe(false);
    expect(store.age_s("hand")).toBeLessThan(0.1);
    expect(oldPart(store)).toBe("");
  });

  test("is that of a queue on the way, although something comes all the time", () => {
    const store = live();
    run(store, 0, 5, () => 20);
    run(store, 5, 10, (at_s) => 20 + 500 * (at_s - 5));
    store.look(12_500, 12_500);
    expect(store.pictureAge).toBeGreaterThan(2.3);
    expect(bannersOf(Object.assign(store, {}), "open", "")[0]![1]).toBe("NOT CONNECTED: what this page shows is 2.5 s old");
  });

  test("is that of one device which is silent while others are not", () => {
    const store = live();
    run(store, 0, 5, () => 20);
    run(store, 5, 8, () => 20, (at_s) => ({ tip: sample(at_s, 1) }));
    store.look(8000, 8000);
    expect([store.isPictureOld, store.isOld("hand"), store.isOld("tip")]).toEqual([false, true, false]);
    expect(oldPart(store)).toMatch(/^Nothing has come from the hand for 3\.\d s$/);
    expect(store.age_s("nothing")).toBeNaN();
  });

  test("of a machine that slept is not none before anything has come", () => {
    const store = live();
    run(store, 0, 5, () => 20);
    store.look(5000, 5000);
    // the clock of the page stood still, and that of the wall did not
    store.look(5016, 65_016);
    expect(store.isPictureOld).toBe(true);
    store.take({ k: "tick", at_s: 1065.1, streams: both(1065.1) }, 5100);
    store.look(5120, 65_120);
    expect(store.isPictureOld).toBe(false);
  });

  test("of drifting clocks stays right for an hour", () => {
    const store = live();
    for (let at_s = 0; at_s < 3600; at_s += 0.2) store.take({ k: "tick", at_s: 1000 + at_s * (1 + 1e-4), streams: both(1000 + at_s * (1 + 1e-4)) }, 1e3 * at_s);
    store.look(3_600_000, 3_600_000);
    expect(store.pictureAge).toBeLessThan(0.3);
    store.look(3_603_000, 3_603_000);
    expect(store.pictureAge).toBeGreaterThan(2.9);
  });
});

test("all that is read in a frame is of one instant", () => {
  const store = live();
  store.take({ k: "tick", at_s: 1000, streams: both(1000, 3), state: { "afm/state/slave": { in_contact: false } } }, 0);
  store.look(10, 10);
  store.take({ k: "tick", at_s: 1000.1, streams: both(1000.1, 4), state: { "afm/state/slave": { in_contact: true } } }, 100);
  expect([store.last("hand", "position"), store.last("tip", "separation"), store.fact("afm/state/slave", "in_contact")]).toEqual([3, 3, false]);
  store.look(110, 110);
  expect([store.last("hand", "position"), store.last("tip", "separation"), store.fact("afm/state/slave", "in_contact")]).toEqual([4, 4, true]);
});
