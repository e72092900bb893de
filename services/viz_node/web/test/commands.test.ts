import { expect, test, vi } from "vitest";
import { Commands } from "../src/commands";
import { Store } from "../src/store";

/** A page whose server answers each request when the test says so. */
function page(): { commands: Commands; store: Store; asked: object[]; notes: string[]; answer: (ok: boolean, text: string) => void } {
  const store = new Store();
  const asked: object[] = [];
  const waiting: ((answer: object) => void)[] = [];
  const ask = (fields: object): Promise<object> => {
    asked.push(fields);
    return new Promise((resolve) => waiting.push(resolve));
  };
  const notes: string[] = [];
  const answers = {
    tell: () => {},
    pending: (about: string) => notes.push(`${about} …`) as never as HTMLElement,
    settle: (_: HTMLElement, outcome: string, words: string) => void notes.push(`${outcome}: ${words}`),
  };
  const commands = new Commands({ ask } as never, store, answers);
  return { commands, store, asked, notes, answer: (ok, text) => waiting.shift()!({ ok, text, outcome: ok ? "acknowledged" : "refused", waited_s: 0.1 }) };
}

test("hand and tip are armed by one request, whose result is shown", async () => {
  for (const ok of [true, false]) {
    const { commands, store, asked, notes, answer } = page();
    commands.link = "open";
    const done = commands.arm();
    expect(asked.map((fields) => [(fields as { command: string }).command, (fields as { target: string }).target])).toEqual([["arm", "*"]]);
    expect(notes).toEqual(["arm hand and tip …"]);
    answer(ok, "afm_node@slave: the tip is placed");
    expect(await done).toBe(ok);
    const words = `arm hand and tip: ${ok ? "acknowledged" : "refused"} · afm_node@slave: the tip is placed`;
    expect(notes[1]).toBe(`${ok ? "acknowledged" : "refused"}: ${words}`);
    // what was acknowledged is an event of the nodes, and no second one of the page
    expect(store.events.map(({ src, level, text }) => [src, level, text])).toEqual(ok ? [] : [["this page", "warning", words]]);
  }
});

test("what takes a while arms at its end only where no stop came meanwhile, from this page or from elsewhere", () => {
  const { commands, store } = page();
  commands.link = "open";
  const state = (hand: boolean): void => store.take({ k: "tick", state: { "haptic/state/master": { estop: hand } } });
  const begun = commands.mayArmLater();
  expect(begun()).toBe(true);
  state(true);
  expect(begun()).toBe(false);
  const knows = commands.mayArmLater();
  expect(knows()).toBe(true);
  void commands.estop();
  expect(knows()).toBe(false);
});

test("nothing arms for 1.5 s after a press of the stop, or after a stop is first seen", () => {
  vi.useFakeTimers();
  const { commands, store } = page();
  commands.link = "open";
  store.role = "operator";
  store.commands = true;
  const state = (hand: boolean): void => store.take({ k: "tick", state: { "haptic/state/master": { estop: hand } } });
  const after = (ms: number): boolean => {
    vi.advanceTimersByTime(ms);
    return commands.mayArm(performance.now());
  };
  expect(after(0)).toBe(true);
  void commands.estop();
  state(true);
  expect([after(0), after(1400), after(200)]).toEqual([false, false, true]);
  // each further press counts, and so does a stop that came from elsewhere
  void commands.estop();
  expect([after(1400), after(200)]).toEqual([false, true]);
  state(false);
  expect(after(50)).toBe(true);
  state(true);
  expect([after(50), after(1400), after(200)]).toEqual([false, false, true]);
  // not on a page that may not arm, or whose connection is lost
  store.role = "observer";
  expect(after(50)).toBe(false);
  store.role = "operator";
  commands.link = "lost";
  expect(after(50)).toBe(false);
  vi.useRealTimers();
});

test("a stop that cannot be sent is not called refused", async () => {
  const { commands, notes } = page();
  commands.link = "lost";
  await commands.estop();
  expect(notes[1]).toMatch(/^not sent: emergency stop: not sent · .*type: telenano estop$/);
});

test("the way back has its numbers, goes by a word of its own, and is ended by a key or a press", async () => {
  const { commands, store, asked, answer } = page();
  commands.link = "open";
  expect(commands.wayBack).toBeUndefined();
  expect(await commands.goBack()).toBe(false);
  store.take({ k: "tick", state: { "afm/state/slave": { mode: "follow", return_place_m: 1.05e-8, return_speed_m_per_s: 5e-8, return_s: 2.2 } } });
  expect(commands.wayBack?.text).toBe("Go back to 10.5 nm (50 nm/s, 2.2 s)");
  const listeners = new Map<string, (event: object) => void>();
  vi.stubGlobal("addEventListener", (name: string, listener: (event: object) => void) => void listeners.set(name, listener));
  vi.stubGlobal("removeEventListener", (name: string) => void listeners.delete(name));
  for (const [name, event, ends] of [["keydown", { key: "x" }, 1], ["pointerdown", {}, 1], ["keydown", { key: "Escape" }, 0]] as const) {
    const before = asked.length;
    const done = commands.goBack();
    expect(commands.goingAt(performance.now())?.text).toMatch(/^The tip goes back to 10.5 nm \(50 nm\/s, 2.2 s\): [12]\.\d s left$/);
    expect(asked.slice(before)).toMatchObject([{ command: "arm", target: "*", parameters: { place_m: 1.05e-8, speed_m_per_s: 5e-8 } }]);
    listeners.get(name)!(event);
    listeners.get(name)!(event);
    // arming starts nothing, and what is pressed again asks for no more; the stop is a request of its own
    expect(asked.slice(before + 1)).toMatchObject(Array(ends).fill({ command: "arm", target: "*", parameters: {} }));
    answer(false, "another command came after it");
    if (ends) answer(true, "armed already");
    expect(await done).toBe(false);
    expect(commands.goingAt(performance.now())).toBeUndefined();
    expect(listeners.size).toBe(0);
  }
  vi.unstubAllGlobals();
});

test("a tip that is to stay withdrawn is not offered its way back first, until it has another one or is armed anew", async () => {
  const { commands, store, answer } = page();
  commands.link = "open";
  const back = (return_place_m: number): void => store.take({ k: "tick", state: { "afm/state/slave": { mode: "follow", return_place_m, return_speed_m_per_s: 5e-8, return_s: 2.2 } } });
  back(1.05e-8);
  expect(commands.stays).toBe(false);
  commands.stay();
  expect(commands.stays).toBe(true);
  back(2e-8);
  expect(commands.stays).toBe(false);
  commands.stay();
  const done = commands.arm();
  expect(commands.stays).toBe(false);
  answer(true, "armed");
  await done;
  // what is nearly 0 is 0
  back(-1.393e-14);
  expect(commands.wayBack?.text).toBe("Go back to 0.0 nm (50 nm/s, 2.2 s)");
});
