import { createInterface } from "node:readline";
import { decode } from "@msgpack/msgpack";
import { Commands } from "../src/commands";
import { LOWER_M, lowerBy, nextOf } from "../src/next";
import type { Answer, Facts, Snapshot, Tick } from "../src/protocol";
import { Situations } from "../src/situation";
import { Spring } from "../src/spring";
import { Store } from "../src/store";

/**
 * The page without a browser, for a walk through a rig in virtual time: a line of JSON comes for each step, with the
 * frames of the server and the key that is pressed, and a line goes back with what is next, what is asked for and the
 * force of the hand. What decides is that of the page; only the pad and the socket are other ones.
 */
interface Step {
  now_ms: number;
  /** Frames of the server, in msgpack and base64. */
  frames: string[];
  /** Answers to what was asked for, in the order in which it was. */
  answers?: { ok: boolean; text: string }[];
  key?: string;
  /** Load the page again. */
  reload?: boolean;
}

const ME = "walker";
let now_ms = 0;
let page = load();
globalThis.performance.now = () => now_ms;
Object.assign(globalThis, { addEventListener: (name: string, listener: (event: unknown) => void) => page.listeners.set(name, listener), removeEventListener: (name: string) => page.listeners.delete(name) });

function load() {
  const store = new Store();
  const spring = new Spring();
  const asked: Facts[] = [];
  const waiting: ((answer: Answer & { outcome: string; waited_s: number }) => void)[] = [];
  const connection = { ask: (fields: Facts) => new Promise((resolve) => (asked.push(fields), waiting.push(resolve as never))) };
  const answers = { pending: () => ({}), settle: () => undefined, tell: () => undefined };
  const commands = new Commands(connection as never, store, answers as never);
  commands.link = "open";
  let meant: number | undefined;
  const hand = {
    get isOffered(): boolean {
      return commands.may;
    },
    get isHeld(): boolean {
      return meant !== undefined;
    },
    mean(at_m: number | undefined): void {
      meant = at_m;
      spring.mean(at_m ?? null, true, now_ms);
    },
    get meant(): number {
      return meant ?? hand.arm;
    },
    get arm(): number {
      return store.last("hand", "position");
    },
  };
  commands.onArm = commands.onEstop = () => hand.mean(undefined);
  const tip = {
    get program(): string {
      return ["running", "paused"].includes(String(store.fact("afm/program/slave", "state"))) ? String(store.fact("afm/program/slave", "program")) : "";
    },
  };
  const listeners = new Map<string, (event: unknown) => void>();
  return { store, spring, asked, waiting, commands, hand, tip, listeners, situations: new Situations({ store, commands, hand, tip }), followed: false };
}

createInterface({ input: process.stdin }).on("line", (line) => {
  const step = JSON.parse(line) as Step;
  now_ms = step.now_ms;
  if (step.reload) page = load();
  for (const text of step.frames) {
    const frame = decode(new Uint8Array(Buffer.from(text, "base64"))) as Snapshot | Tick;
    page.spring.take(frame);
    if (frame.k === "snapshot") page.store.begin(frame);
    else page.store.take(frame, now_ms);
  }
  const { store, commands, hand, spring } = page;
  for (const answer of step.answers ?? []) page.waiting.shift()?.({ k: "answer", id: "", outcome: answer.ok ? "acknowledged" : "refused", waited_s: 0, ...answer });
  // what was answered goes on before anything else is seen
  setImmediate(() => {
    store.look(now_ms, now_ms);
    const mode = store.fact("afm/state/slave", "mode");
    const follows = page.tip.program === "" && (mode === "follow" || mode === "hold");
    if (page.followed && !follows && hand.isHeld) hand.mean(undefined);
    page.followed = follows;
    const situation = page.situations.at(now_ms);
    const next = nextOf(situation);
    if (step.key) {
      page.listeners.get("keydown")?.({ key: step.key });
      const chosen = step.key === "n" ? next.offer : next.other;
      if (chosen?.isReady) {
        const acts: Record<string, () => unknown> = {
          take: () => (store.lease = { number: store.lease.number + 1, holder: ME, label: "window A", what: "page", kept: true, asking: [] }),
          arm: () => commands.arm(),
          start: () => commands.command("start", "start", "haptic_node"),
          stay: () => commands.stay(),
          "go back": () => commands.goBack(),
          hold: () => hand.mean(hand.arm),
          lower: () => hand.mean(Math.max(hand.meant + LOWER_M, hand.arm + lowerBy(situation.touches ? NaN : situation.needs_m))),
          lift: () => hand.mean(Math.max((store.travel_m?.[0] ?? -5e-3) + 0.5e-3, hand.arm - situation.lift_m - 0.5e-3)),
          "let go": () => hand.mean(undefined),
        };
        void acts[chosen.act]?.();
      }
    }
    if (hand.isHeld) spring.mean(hand.meant, true, now_ms);
    const force_n = spring.next(now_ms) ?? 0;
    setImmediate(() => {
      const after = nextOf(page.situations.at(now_ms));
      process.stdout.write(`${JSON.stringify({ step: after.step, says: after.says, offer: after.offer ?? null, other: after.other ?? null, asked: page.asked.splice(0), force_n, held: hand.isHeld, touches: situation.touches, me: ME })}\n`);
    });
  });
});
