import { describe, expect, it } from "vitest";
import { aloneText } from "../src/situation";
import { lowerBy, nextOf, STEPS, stepStates, type Situation } from "../src/next";

const rest: Situation = {
  link: "open", linkText: "", kind: "live", role: "operator", hasRig: true, holdsControl: true, isControlFree: false, lease: "You hold control", leaseAction: "Give up control",
  isStopped: false, mayArm: true, tipMode: "follow", tipArmed: true, placed: true, runs: true, program: "", wayBack: "", going: "", stays: false,
  offersHand: true, isHeld: false, touches: false, swing_n: NaN, separation_nm: 9.7, pressed_n: 0, felt_n: 0,
  old: "", alone: "", oldPart: "", travelLeft_m: 14.5e-3, needs_m: 9.7e-3, lift_m: 0, isForceLimited: false,
};
const at = (changes: Partial<Situation>): [string, string | undefined, string | undefined] => {
  const { step, offer, other } = nextOf({ ...rest, ...changes });
  return [step, offer?.act, other?.act];
};

describe("what is next", () => {
  it.each<[string, Partial<Situation>, [string, string | undefined, string | undefined]]>([
    ["no connection", { link: "lost", linkText: "the server does not answer" }, ["connect", "reload", undefined]],
    ["no rig yet", { hasRig: false }, ["connect", undefined, undefined]],
    ["control is free", { holdsControl: false, isControlFree: true, leaseAction: "Take" }, ["control", "take", undefined]],
    ["another window has it", { holdsControl: false, leaseAction: "Ask", lease: "Window B holds control" }, ["control", "take", undefined]],
    ["asked already", { holdsControl: false, leaseAction: "", lease: "Window B holds control; you have asked" }, ["control", undefined, undefined]],
    ["stopped", { isStopped: true }, ["arm", "arm", undefined]],
    ["stopped, and control is free", { isStopped: true, holdsControl: false, isControlFree: true }, ["arm", "arm", undefined]],
    ["stopped, and another window has control", { isStopped: true, holdsControl: false }, ["control", "take", undefined]],
    ["withdrawn", { tipMode: "retracted" }, ["arm", "arm", undefined]],
    ["on its way from the sample", { tipMode: "retracting" }, ["arm", undefined, undefined]],
    ["a program", { program: "scan" }, ["arm", undefined, undefined]],
    ["no session", { runs: false }, ["arm", "start", undefined]],
    ["armed with a way back", { wayBack: "Go back to 10.5 nm" }, ["approach", "go back", "stay"]],
    ["armed with a way back, after an act", { wayBack: "Go back to 10.5 nm", holdsControl: false, isControlFree: true }, ["approach", "go back", "stay"]],
    ["it stays withdrawn", { wayBack: "Go back to 10.5 nm", stays: true }, ["approach", "hold", "go back"]],
    ["on its way back", { wayBack: "Go back to 10.5 nm", going: "The tip goes back: 1.2 s left" }, ["approach", undefined, "end way"]],
    ["placed by a session", { placed: false }, ["approach", undefined, undefined]],
    ["a free hand", {}, ["approach", "hold", undefined]],
    ["a hand that is held", { isHeld: true }, ["approach", "lower", "let go"]],
    ["a hand that presses", { isHeld: true, touches: true }, ["let go", "let go", "lower"]],
    ["a swing while the tip is off the sample", { isHeld: true, swing_n: 4.7 }, ["let go", "let go", undefined]],
    ["a swing while the tip touches", { isHeld: true, touches: true, swing_n: 4.7 }, ["let go", "let go", undefined]],
    ["a swing of a device", { offersHand: false, touches: true, swing_n: 4.7 }, ["let go", undefined, undefined]],
    ["a swing after which the hand is free", { swing_n: 4.7 }, ["approach", "hold", undefined]],
    ["a tip that rests on the sample", { touches: true }, ["touch", "hold", undefined]],
    ["a device is the hand", { offersHand: false }, ["approach", undefined, undefined]],
    ["a hand at the end of its travel, too low to meet the tip", { isHeld: true, travelLeft_m: 0, needs_m: 6.5e-3, lift_m: 14.5e-3 }, ["approach", "lift", undefined]],
    ["a hand that does not reach so far, of a tip that can come back", { travelLeft_m: 9e-3, needs_m: 0.11, wayBack: "Go back to 0.0 nm", stays: true }, ["approach", "go back", undefined]],
    ["armed with a way back, and the hand where the sample is", { wayBack: "Go back to 0.0 nm", lift_m: 7.4e-3 }, ["approach", "lift", "stay"]],
    ["a tip that waits above the sample for the hand", { placed: false, lift_m: 7.4e-3 }, ["approach", "lift", undefined]],
    ["nothing heard", { old: "this page has heard nothing for 3.0 s", touches: true, isHeld: true }, ["connect", undefined, undefined]],
    ["nothing heard of the hand", { oldPart: "Nothing has come from the hand for 3.0 s" }, ["arm", undefined, undefined]],
    ["nothing heard of the hand after a stop", { oldPart: "Nothing has come from the hand for 3.0 s", isStopped: true }, ["arm", "arm", undefined]],
    ["an observer", { role: "observer" }, ["", undefined, undefined]],
    ["a recording", { kind: "recording", hasRig: false }, ["", undefined, undefined]],
  ])("%s", (_, changes, expected) => expect(at(changes)).toEqual(expected));

  it("never arms right after a stop, and says so by a button that cannot be pressed", () => {
    expect(nextOf({ ...rest, isStopped: true, mayArm: false }).offer?.isReady).toBe(false);
  });

  it("has one filled button at most, a sentence always, and a key for each button that is not that of the other", () => {
    const choices: { [K in keyof Situation]?: Situation[K][] } = {
      link: ["connecting", "open", "lost", "refused"], kind: ["live", "recording"], role: ["operator", "observer", "participant"], hasRig: [true, false],
      holdsControl: [true, false], isControlFree: [true, false], isStopped: [true, false], tipMode: ["follow", "hold", "retracted", "retracting", "estop", ""],
      runs: [true, false], program: ["", "scan"], wayBack: ["", "Go back"], going: ["", "on its way"], stays: [true, false], placed: [true, false],
      old: ["", "this page has heard nothing for 3.0 s"], alone: ["", "The tip is being withdrawn"], oldPart: ["", "Nothing has come from the hand for 3.0 s"],
      travelLeft_m: [NaN, 0, 4e-3, 14.5e-3], needs_m: [NaN, 0, 9.7e-3, 0.11], lift_m: [0, 7.4e-3, NaN], isForceLimited: [true, false],
      offersHand: [true, false], isHeld: [true, false], touches: [true, false], swing_n: [NaN, 4.7], separation_nm: [NaN, -1.3, 0.04, 9.7, 110],
    };
    // a seeded walk through all of them
    let seed = 11;
    const random = (): number => (seed = (seed * 16807) % 2147483647) / 2147483647;
    const broken = new Set<string>();
    const must = (holds: boolean, what: string): void => { if (!holds) broken.add(what); };
    for (let i = 0; i < 5000; i++) {
      const drawn = Object.fromEntries(Object.entries(choices).map(([key, values]) => [key, values[Math.floor(random() * values.length)]])) as Partial<Situation>;
      const now = { ...rest, ...drawn };
      const { says, offer, other, step } = nextOf(now);
      must(says !== "" && !/NaN|undefined/.test(says), `a whole sentence: ${says}`);
      must(!offer || !other || other.key !== offer.key, "two keys for two buttons");
      must(!offer || offer.key === "n", "the filled button is n");
      for (const each of [offer, other]) if (each) must(each.isReady === (each.why === ""), "what can do nothing says why");
      if (now.link === "open" && now.old) must(!offer && !other, "of what is not of the present nothing is offered");
      if (now.link !== "open" || now.kind === "recording" || now.role === "observer") must([undefined, "reload"].includes(offer?.act), "nothing that moves is offered to who may not command");
      if (now.isStopped && !now.going) must([undefined, "reload", "take", "arm"].includes(offer?.act), "after a stop nothing but control and arming is offered");
      must(step === "" || STEPS.includes(step), `a step that there is: ${step}`);
    }
    expect([...broken]).toEqual([]);
  });

  it("has a button that can do nothing off, with the reason", () => {
    const held = { ...rest, isHeld: true };
    expect(nextOf({ ...held, travelLeft_m: 0, needs_m: NaN }).offer).toMatchObject({ act: "lower", isReady: false, why: "The hand is at the end of its travel: lift it" });
    expect(nextOf({ ...held, touches: true, isForceLimited: true }).other).toMatchObject({ act: "lower", isReady: false, why: /no more force/ });
    expect(nextOf({ ...rest, isStopped: true, mayArm: false }).offer?.why).toMatch(/right after a stop/);
    expect(nextOf({ ...rest, wayBack: "Go back to 0.0 nm", stays: true, lift_m: 7.4e-3 }).other?.why).toMatch(/lift the hand by 7.4 mm/);
  });

  it("lowers most of the way at once, and a little near the sample", () => {
    expect([NaN, 0, 0.3e-3, 2.3e-3, 10e-3].map(lowerBy)).toEqual([0.5e-3, 0.5e-3, 0.5e-3, 2.5e-3, 7.5e-3]);
  });

  it("says what happens by itself while nobody hears this page", () => {
    expect(nextOf({ ...rest, old: "this page has heard nothing for 3.0 s", alone: aloneText(true, 3) }).says).toBe("This page has heard nothing for 3.0 s. This page held the hand: it is let go, and the tip is being withdrawn.");
    expect([aloneText(true, 0.6), aloneText(false, 3)]).toEqual(["The hand is being let go", "What other pages and the rig do goes on"]);
  });

  it("marks what is done before it", () => {
    expect(stepStates("approach", true)).toEqual({ connect: "done", control: "done", arm: "done", approach: "next", touch: "later", "let go": "later" });
    expect(stepStates("arm", false)).toMatchObject({ connect: "done", control: "later", arm: "next" });
    expect(new Set(Object.values(stepStates("", true)))).toEqual(new Set(["later"]));
  });
});
