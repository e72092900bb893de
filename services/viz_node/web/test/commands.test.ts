import { expect, test, vi } from "vitest";
import { Commands } from "../src/commands";
import { Store } from "../src/store";

/** A page whose server answers each request when the test says so. */
function page(): { commands: Commands; store: Store; asked: object[]; answers: HTMLElement[]; answer: (ok: boolean, text: string) => void } {
  const store = new Store();
  const asked: object[] = [];
  const waiting: ((answer: object) => void)[] = [];
  const ask = (fields: object): Promise<object> => {
    asked.push(fields);
    return new Promise((resolve) => waiting.push(resolve));
  };
  const answers: HTMLElement[] = [];
  const commands = new Commands({ ask } as never, store);
  vi.spyOn(commands as never as { pending: (about: string) => HTMLElement }, "pending").mockImplementation((about: string) => {
    const note = { className: "answer pending", textContent: about, remove: () => {} } as never as HTMLElement;
    answers.push(note);
    return note;
  });
  return { commands, store, asked, answers, answer: (ok, text) => waiting.shift()!({ ok, text, lease: 0 }) };
}

test("hand and tip are armed by one request, whose result is shown", async () => {
  for (const ok of [true, false]) {
    const { commands, asked, answers, answer } = page();
    commands.link = "open";
    const done = commands.arm();
    expect(asked.map((fields) => [(fields as { command: string }).command, (fields as { target: string }).target])).toEqual([["arm", "*"]]);
    expect(answers[0]!.className).toBe("answer pending");
    answer(ok, "afm_node@slave: the tip is placed");
    expect(await done).toBe(ok);
    expect(answers[0]!.textContent).toBe(`arm hand and tip: ${ok ? "acknowledged" : "refused"} · afm_node@slave: the tip is placed`);
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

test("the bar that arms is there while the rig is stopped, and cannot be pressed for 1.5 s after a press of the stop", () => {
  vi.useFakeTimers();
  const { commands, store } = page();
  commands.link = "open";
  store.role = "operator";
  store.commands = true;
  const state = (hand: boolean): void => store.take({ k: "tick", state: { "haptic/state/master": { estop: hand } } });
  const after = (ms: number): string => {
    vi.advanceTimersByTime(ms);
    return commands.rearm(performance.now());
  };
  expect(after(0)).toBe("hidden");
  void commands.estop();
  state(true);
  expect([after(0), after(1400), after(200)]).toEqual(["waits", "waits", "ready"]);
  // each further press counts, and so does a stop that came from elsewhere
  void commands.estop();
  expect([after(1400), after(200)]).toEqual(["waits", "ready"]);
  state(false);
  expect(after(50)).toBe("hidden");
  state(true);
  expect([after(50), after(1400), after(200)]).toEqual(["waits", "waits", "ready"]);
  // not on a page that may not arm, or whose connection is lost
  store.role = "observer";
  expect(after(50)).toBe("hidden");
  store.role = "operator";
  commands.link = "lost";
  expect(after(50)).toBe("hidden");
  vi.useRealTimers();
});
