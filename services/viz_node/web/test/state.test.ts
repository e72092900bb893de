import { describe, expect, it, vi } from "vitest";
import { Document } from "../src/document";
import { energyText } from "../src/panels/law";
import { accountText, coupledText, interruptionsText, rangeText, sorted } from "../src/panels/summary";
import { bannersOf } from "../src/state";
import { Store } from "../src/store";
import type { Hold } from "../src/document";
import type { NodeFacts } from "../src/protocol";

const node: NodeFacts = { state: "running", uptime_s: 1, rate_hz: 1000, overruns: 0, cpu_percent: 1, memory_bytes: 1, replay: false, lateness_p99_s: 0, lost: 0, rejected: 0, beat: 0 };
const texts = (store: Store): string => bannersOf(store, "open", "").map(([, text]) => text).join(" | ");

/** A recording that was judged: from 3 s to 7 s of it the force swings. */
function replay(): [Store, Document] {
  const store = new Store();
  store.source = { kind: "recording", name: "session.mcap", length_s: 10, playing: false, position_s: 5 };
  store.take({ k: "tick", nodes: { "haptic_node@master": node } });
  const document = new Document({} as never, store);
  document.about = { length_s: 10, start_ns: 0, read: 1, swings: [{ from_s: 3, to_s: 7, hertz: 0.776, peak_to_peak_n: 4.4 }] };
  return [store, document];
}

describe("the banner", () => {
  it("of a replay says that it oscillates where the page of the live rig did, and from where to where", () => {
    const [store, document] = replay();
    let place = 5;
    store.recordedSwing = () => document.swingAt(place);
    expect(texts(store)).toBe("OSCILLATES: 4.4 N peak to peak at 0.8 Hz | REPLAY: no instrument is connected");
    place = 8;
    expect(texts(store)).toBe("REPLAY: no instrument is connected");
  });

  it("says of what the energy and the motion are, which do not contradict each other", () => {
    const [store, document] = replay();
    store.recordedSwing = () => document.swingAt(5);
    store.take({ k: "tick", state: { "law/status/master": { passive: false } } });
    expect(texts(store)).toContain("NOT PASSIVE: the loop has made energy");
    expect(energyText(true)).toBe("adds no energy");
    expect(energyText(false)).toBe("has added energy");
    expect(energyText(undefined)).toBe("");
  });
});

it("a recording is read to its end although the server did not answer once", async () => {
  vi.useFakeTimers();
  const store = new Store();
  store.source = { kind: "recording", name: "session.mcap", length_s: 10 };
  const about = (read: number): object => ({ ok: true, found: { length_s: 10, start_ns: 0, read } });
  const part = { ok: true, found: { from_s: 0, to_s: 10, width_s: 1, streams: {} } };
  const answers = [about(0.05), part, { ok: false, text: "no answer came" }, about(1), { ok: false, text: "busy" }, about(1), part];
  const ask = vi.fn(() => Promise.resolve(answers.shift()));
  const document = new Document({ ask } as never, store);
  document.begin();
  await vi.advanceTimersByTimeAsync(10_000);
  expect(document.about?.read).toBe(1);
  expect(document.progress).toBe("");
  expect(answers).toEqual([]);
  vi.useRealTimers();
});

describe("the summary", () => {
  const hold = (verdict: string, from_s = 0): Hold => ({ from_s, to_s: from_s + 1, hand_force_n: 1, verdict, reason: "", growth_per_s: null, peak_to_peak_n: 0 });

  it("lists what is to be looked at, and counts what a hand did without anything happening", () => {
    const holds = [...Array.from({ length: 25 }, (_, i) => hold("stable", i)), hold("released", 30), hold("limit_cycle", 31), hold("diverged", 32), { ...hold("stable", 33), frequency_hz: 0.8 }];
    const { notable, others, words } = sorted(holds);
    // a swing that died out was one
    expect(notable.map(({ verdict }) => verdict)).toEqual(["limit_cycle", "diverged", "stable"]);
    expect(others).toHaveLength(26);
    expect(words).toBe("25 stable, 1 released");
    // a few are listed as they are
    expect(sorted([hold("stable"), hold("stable", 2)]).notable).toHaveLength(2);
  });

  it("tells silence from loss, and in which part of a hold hand and tip were both", () => {
    expect(accountText({ complete: true, missing: [] })).toBe("whole");
    expect(accountText({ complete: false, missing: ["7 messages", "its end"] })).toBe("not whole: 7 messages; its end");
    expect(interruptionsText([])).toBe("none");
    const silent = { kind: "source_silent" };
    expect(interruptionsText([silent, { kind: "tip_held" }, silent])).toBe("hand or AFM sent nothing (2 times), the tip was held");
    expect(coupledText({ coupled_share: 0.05 })).toBe(", hand and tip coupled for 5 %");
    // a recording of before says nothing of it
    expect(coupledText({}) + coupledText({ coupled_share: 1 })).toBe("");
  });

  it("tells of a delay that was set in the session", () => {
    expect(rangeText([0, 400])).toBe("0.0 to 400.0 ms");
    expect(rangeText([50.1, 50.3])).toBe("50.2 ms");
  });
});

describe("the banner of arming", () => {
  const live = (hand: boolean, mode: string, further: object = {}): string => {
    const store = new Store();
    store.source = { kind: "live", name: "rig" } as never;
    store.take({ k: "tick", nodes: { "haptic_node@master": node }, state: { "haptic/state/master": { estop: hand }, "afm/state/slave": { mode, ...further } } });
    return texts(store);
  };

  it("names the device that is stopped where the other one is not", () => {
    expect(live(true, "estop")).toContain("EMERGENCY STOP: arm to continue");
    expect(live(true, "retracted")).toContain("EMERGENCY STOP OF THE HAND: arm to continue");
    expect(live(false, "estop")).toContain("EMERGENCY STOP OF THE TIP: arm to continue");
  });

  it("does not say of a tip that waits, or is on its way, that it follows the hand", () => {
    expect(live(false, "retracted", { armed: true })).toContain("the tip is armed, and waits until the hand is armed");
    expect(live(false, "follow", { placed: false })).toContain("the tip is on its way to the hand");
    expect(live(false, "follow", { placed: true })).toContain("the tip follows the hand");
  });

  it("does not say that it runs where the tip does not follow: it says why, of each reason of a guard", () => {
    const store = new Store();
    store.source = { kind: "live", name: "rig" } as never;
    const report = (level: string, mode: string, reason: string, seq: number): string => {
      const event = { src: "afm_node@slave", seq, t: seq, kind: "mode", level, text: `the AFM is in mode ${mode}: ${reason}` };
      store.take({ k: "tick", nodes: { "haptic_node@master": node }, state: { "afm/state/slave": { mode } }, events: [event] as never });
      return texts(store);
    };
    expect(report("info", "follow", "armed", 0)).toBe("running | the tip follows the hand");
    expect(report("warning", "retracting", "force_limit", 1)).toBe("THE TIP MOVES AWAY: the force on the tip was above its limit");
    expect(report("warning", "retracted", "force_limit", 2)).toBe("THE TIP IS WITHDRAWN: the force on the tip was above its limit");
    expect(report("warning", "retracted", "device_lost", 3)).toContain("the instrument does not answer");
    expect(report("warning", "hold", "command_deadline", 4)).toContain("THE TIP HOLDS ITS PLACE");
    // somebody wanted it so: nothing is to be explained
    expect(report("info", "retracted", "retract_requested", 5)).toBe("THE TIP IS WITHDRAWN");
    store.take({ k: "tick", state: { "afm/program/slave": { program: "scan", state: "running", text: "", done_percent: 3 } } });
    expect(texts(store)).toContain("running");
  });
});
