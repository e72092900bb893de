import type { LinkState } from "./connection";
import { programName } from "./programs";
import type { Role } from "./protocol";
import { fixed, forceText } from "./numbers";

/** What an operator does one after the other. */
export const STEPS = ["connect", "control", "arm", "approach", "touch", "let go"] as const;
export type StepName = (typeof STEPS)[number];
export type StepState = "done" | "next" | "later";

/** What the page does when the button is pressed. */
export type Act = "reload" | "take" | "arm" | "start" | "by hand" | "stay" | "go back" | "end way" | "hold" | "lower" | "lift" | "let go";
export interface Offer {
  act: Act;
  label: string;
  /** The key that does the same: n for the filled button, whatever it is. */
  key: string;
  isReady: boolean;
  /** Why it can do nothing now; empty where it can. */
  why: string;
}

/** Everything that decides what is next. */
export interface Situation {
  link: LinkState;
  linkText: string;
  /** That what this page knows is not of the present, and what happens by itself meanwhile; empty where it is. */
  old: string;
  alone: string;
  /** Of which device nothing has come, and for how long; empty where all that moves is of the present. */
  oldPart: string;
  kind: "live" | "recording";
  role: Role;
  /** Whether a node has reported. */
  hasRig: boolean;
  /** Whether this page is the holder of control. */
  holdsControl: boolean;
  isControlFree: boolean;
  /** Who holds control otherwise, in words, and what this page may do about it; empty where it may do nothing. */
  lease: string;
  leaseAction: string;
  isStopped: boolean;
  /** After a press of the stop nothing arms for a while. */
  mayArm: boolean;
  tipMode: string;
  tipArmed: boolean;
  placed: boolean;
  runs: boolean;
  program: string;
  /** What an armed tip would go back to, in words; empty where it has no way back. */
  wayBack: string;
  /** How far the way back is; empty where it does not go. */
  going: string;
  /** Whether the person has chosen that the tip stays withdrawn. */
  stays: boolean;
  /** Whether this page may hold a hand, and whether it does. */
  offersHand: boolean;
  isHeld: boolean;
  touches: boolean;
  /** How far the force at the hand swings from peak to peak by itself [N]; NaN where it does not. */
  swing_n: number;
  /** Distance of tip and sample [nm], NaN where it is not known, and the forces at the hand and at the tip [N]. */
  separation_nm: number;
  /** What the hand still has of its travel towards the sample, and what a touch takes [m]; NaN where that is not known. */
  travelLeft_m: number;
  needs_m: number;
  /** How far the hand has to be lifted before it has the travel of a fresh start when the tip comes back [m]. */
  lift_m: number;
  /** Whether the hand gives no more force, however low it is meant to be. */
  isForceLimited: boolean;
  pressed_n: number;
  felt_n: number;
}

export interface Next {
  step: StepName | "";
  says: string;
  /** The one filled button. */
  offer: Offer | undefined;
  /** What may be done instead, unfilled. */
  other: Offer | undefined;
}

const offer = (act: Act, label: string, key = "n", why = ""): Offer => ({ act, label, key, isReady: why === "", why });
const nothing = (step: Next["step"], says: string): Next => ({ step, says, offer: undefined, other: undefined });
const mm = (way_m: number): string => fixed(1e3 * way_m, 1);
/** Smaller than this no hand is lifted, and no offset counts [m]. */
const LIFT_M = 0.3e-3;
/** A press of *Lower* goes this share of the way to the sample, all of a way that is short, and at least so far [m]. */
const LOWER_SHARE = 0.75;
const SHORT_M = 3e-3;
export const LOWER_M = 0.5e-3;

/** How far one press of *Lower* goes [m]: most of the way to the sample, and a little where that is not known. */
export function lowerBy(needs_m: number): number {
  if (Number.isNaN(needs_m)) return LOWER_M;
  return Math.max(LOWER_M, Math.ceil((needs_m > SHORT_M ? LOWER_SHARE : 1) * needs_m * 2e3) / 2e3);
}

/** What an instrument does that runs a program. */
const busy = (program: string): string => `The program ${programName(program)} runs, and the hand moves nothing until it ends`;

/** What is next, why, and which button does it. */
export function nextOf(now: Situation): Next {
  if (now.link === "connecting") return nothing("connect", "Connecting to the rig.");
  if (now.link !== "open") return { step: "connect", says: `Not connected: ${now.linkText}.${now.alone && ` ${now.alone}.`}`, offer: offer("reload", "Load the page again"), other: undefined };
  // what is known is of the past: nothing of it is offered
  if (now.old) return nothing("connect", `${now.old[0]!.toUpperCase()}${now.old.slice(1)}.${now.alone && ` ${now.alone}.`}`);
  if (now.kind === "recording") return nothing("", "This is a recording: nothing moves. The space bar plays it, and e goes to the next event.");
  if (!now.hasRig) return nothing("connect", "Waiting for a rig: no node has reported yet.");
  if (now.role !== "operator") return nothing("", `You are an observer: you can look, and stop the rig. ${now.lease}.`);
  // A stop is armed after, and a tip that goes back ended, by whoever is there; control that is free is then taken for the act.
  const isUrgent = now.isControlFree && (now.isStopped || now.isHeld || now.going !== "" || now.wayBack !== "");
  if (!now.holdsControl && !isUrgent) {
    const isFree = now.isControlFree;
    const says = now.program ? `${busy(now.program)}. ${now.lease}.` : isFree ? `${now.lease === "Control is free" ? "Nobody holds control" : now.lease}. While you have it, no other window can act.` : `${now.lease}.`;
    return { step: "control", says, offer: now.leaseAction ? offer("take", isFree ? "Take control" : `${now.leaseAction} for control`) : undefined, other: undefined };
  }
  // to end it is no step towards a touch: who presses n once more must not do so by a filled button
  if (now.going) return { ...nothing("approach", `${now.going}. Any key or click stops it there.`), other: offer("end way", "End it here", "e") };
  return armed(now) ?? touching(now);
}

/** What has to be done before a hand moves the tip; undefined where it does. */
function armed(now: Situation): Next | undefined {
  const arm = (says: string): Next => ({ step: "arm", says, offer: offer("arm", "Arm", "n", now.mayArm ? "" : "Not right after a stop: wait a moment"), other: undefined });
  if (now.isStopped) return arm("Stopped. Arm hand and tip: both stay where they are, and then you choose whether the tip goes back.");
  if (now.program) return nothing("arm", `${busy(now.program)}.`);
  if (now.tipMode === "retracting") return nothing("arm", "The tip moves away from the sample: wait until it is away.");
  if (now.oldPart) return nothing("arm", `${now.oldPart}.`);
  if (now.tipMode === "retracted") return arm(now.tipArmed ? "The tip is armed, and waits until the hand is armed too." : "The tip is withdrawn. Arm hand and tip: both stay where they are.");
  if (now.tipMode !== "follow" && now.tipMode !== "hold") return nothing("arm", "Waiting for the instrument to report what it does.");
  if (!now.runs) return { step: "arm", says: "The session has not begun, or was stopped.", offer: offer("start", "Start"), other: undefined };
  if (now.wayBack && !now.stays) {
    const isLow = now.lift_m > LIFT_M;
    if (isLow) return lift(now, "Armed. The hand is where the sample is", offer("stay", "Stay withdrawn", "w"));
    return { step: "approach", says: "Armed. The tip is withdrawn: let it stay there, or let it go back.", offer: offer("go back", now.wayBack), other: offer("stay", "Stay withdrawn", "w") };
  }
  if (!now.placed) return now.lift_m > LIFT_M ? lift(now, "The tip waits above the sample") : nothing("approach", "The tip is on its way to the hand.");
  return undefined;
}

/** A hand that is too low is lifted first: then the tip comes back to where it is, and it has all of its travel. */
function lift(now: Situation, says: string, other?: Offer): Next {
  const by = `lift the hand by ${mm(now.lift_m)} mm`;
  return { step: "approach", says: `${says}: ${by}, and the tip meets it in the free.`, offer: now.offersHand ? offer("lift", "Lift the hand") : undefined, other };
}

/** What a hand does with a tip that follows it. */
function touching(now: Situation): Next {
  const distance = Number.isNaN(now.separation_nm) ? "The tip follows the hand" : `The tip is ${fixed(Math.max(0, now.separation_nm), now.separation_nm < 9.95 ? 1 : 0)} nm above the sample`;
  const back = now.wayBack ? offer("go back", now.wayBack, "g", now.lift_m > LIFT_M ? `First lift the hand by ${mm(now.lift_m)} mm: then it has all of its travel` : "") : undefined;
  // a hand that ends before the sample begins would be lowered for nothing
  const isShort = !now.touches && now.travelLeft_m < now.needs_m;
  if (isShort && now.lift_m > LIFT_M) return lift(now, `${distance}, and the hand has ${mm(now.travelLeft_m)} mm left`);
  if (isShort && now.wayBack) return { step: "approach", says: `${distance}, and the hand does not reach that far: let the tip go back.`, offer: offer("go back", now.wayBack), other: now.isHeld ? offer("let go", "Let go", "u") : undefined };
  // A hand that is let go takes the energy out of a swing, which more force on the sample does not.
  if (!Number.isNaN(now.swing_n) && (now.isHeld || !now.offersHand)) {
    const says = `The force swings by ${fixed(now.swing_n, 1)} N: let go${now.offersHand ? "" : " of the haptic device"}, then choose less delay or another law.`;
    return { ...nothing("let go", says), offer: now.offersHand ? offer("let go", "Let go") : undefined, other: back };
  }
  if (!now.offersHand) {
    const says = now.touches ? `The tip touches: ${forceText(now.felt_n)} N come back to the hand.` : `${distance}: press with the haptic device.`;
    return { ...nothing(now.touches ? "touch" : "approach", says), other: back };
  }
  if (!now.isHeld) {
    const says = now.touches ? "The tip rests on the sample, and nobody holds the hand." : `${distance}, and nobody holds the hand: hold it, then drag it down.`;
    return { step: now.touches ? "touch" : "approach", says, offer: offer("hold", "Hold the hand"), other: back };
  }
  const least = now.isForceLimited ? "The hand gives no more force: it is at its limit" : now.travelLeft_m < LIFT_M ? "The hand is at the end of its travel: lift it" : "";
  if (!now.touches) {
    const by = lowerBy(now.needs_m);
    const says = least ? `${distance}. ${least}.` : `${distance}: drag the hand down, or press ↓ on it.`;
    return { step: "approach", says, offer: offer("lower", `Lower by ${mm(by)} mm`, "n", least), other: offer("let go", "Let go", "u") };
  }
  // what is felt tells whether it touches well: a press that comes back as it is
  const more = least ? `${least}.` : "Press harder or softer as you like; let go when you are done.";
  return { step: "let go", says: `You press ${forceText(now.pressed_n)} N and feel ${forceText(now.felt_n)} N. ${more}`, offer: offer("let go", "Let go"), other: offer("lower", "Press 0.5 mm more", "d", least) };
}

/** How each step stands: what comes before the one that is next is done, but for control that the next act takes by itself. */
export function stepStates(step: Next["step"], holdsControl: boolean): Record<StepName, StepState> {
  const at = STEPS.indexOf(step as StepName);
  const stateOf = (name: StepName, i: number): StepState => (i === at ? "next" : i < at && (name !== "control" || holdsControl) ? "done" : "later");
  return Object.fromEntries(STEPS.map((name, i) => [name, stateOf(name, i)])) as Record<StepName, StepState>;
}
