import { describe, expect, test } from "vitest";
import type { NodeFacts } from "../src/protocol";
import { Clock, LOST_MS, Store } from "../src/store";

const facts: NodeFacts = { state: "running", uptime_s: 1, rate_hz: 1000, overruns: 0, cpu_percent: 1, memory_bytes: 1, replay: false, lateness_p99_s: 0, lost: 0, rejected: 0, beat: 0 };

/** Let time pass as the page does: in steps of its timer. */
function pass(store: Store, from: number, to: number, step = 50): void {
  for (let now = from; now <= to; now += step) store.clock.tick(now);
}

describe("a lost node", () => {
  test("is shown within a second of its last report, and not while reports come twice a second", () => {
    const store = new Store();
    for (let beat = 0; beat < 5; beat++) {
      store.take({ k: "tick", nodes: { "afm_node@slave": facts, "console@master": facts } });
      pass(store, beat * 500, beat * 500 + 499);
      expect(store.lost()).toEqual([]);
    }
    // the last report came at 2000 ms
    pass(store, 2500, 3000);
    expect(store.lost()).toEqual(["afm_node@slave"]);
    store.take({ k: "tick", nodes: { "afm_node@slave": facts } });
    expect(store.lost()).toEqual([]);
  });

  test("is not one that said farewell, and a recording has none", () => {
    const store = new Store();
    store.take({ k: "tick", nodes: { "recorder@master": { ...facts, state: "ended" }, "afm_node@slave": facts } });
    pass(store, 0, 2 * LOST_MS);
    expect(store.lost()).toEqual(["afm_node@slave"]);
    store.take({ k: "tick", source: { kind: "recording", name: "session.mcap" } });
    expect(store.lost()).toEqual([]);
  });

  test("is not invented by a page that itself stood still", () => {
    const clock = new Clock();
    clock.tick(0);
    clock.tick(5000);
    expect(clock.ms).toBeLessThanOrEqual(100);
  });
});
