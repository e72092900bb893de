import type { LinkState } from "./connection";
import { leaseOffer } from "./lease";
import type { Situation } from "./next";
import { LIMIT_N } from "./spring";
import { isSilent, oldPart, oldWords, swingOf } from "./state";
import type { Store } from "./store";

const AFM = "afm/state/slave";
const HAND = "haptic/state/master";
/** A page that held the hand and is not heard for this long has lost control, and the tip is withdrawn [s]. */
const VANISHED_S = 1;
/** A smaller way of the hand says nothing of the scale between hand and tip [m]. */
const LEAST_OF_SCALE_M = 0.3e-3;

/** What of the page decides what is next, beside what it knows of the rig. */
export interface Deciding {
  store: Store;
  commands: {
    link: LinkState;
    linkText: string;
    isStopped: boolean;
    stays: boolean;
    wayBack: { text: string } | undefined;
    mayArm(now: number): boolean;
    goingAt(now: number): { text: string } | undefined;
  };
  hand: { isOffered: boolean; isHeld: boolean };
  tip: { program: string };
}

/** Everything that decides what is next, from one instant of the rig and from what this page does. */
export class Situations {
  /** Whether this page held the hand when it was last heard. */
  private wasHeld = false;
  /** The base goes so far for a way of the hand [m/m]; NaN before the hand has moved. */
  private scale = NaN;

  constructor(private readonly cockpit: Deciding) {}

  /** The situation in the instant that is shown, at a time [ms]. */
  at(now: number): Situation {
    const { store, commands, hand, tip } = this.cockpit;
    const { text, actions } = leaseOffer(store.lease, store.me, store.role);
    const isMine = store.lease.holder !== "" && store.lease.holder === store.me;
    const found = (name: string): unknown => store.fact(AFM, name);
    const old = store.isPictureOld ? oldWords(store) : "";
    if (commands.link === "open" && !old) this.wasHeld = hand.isHeld;
    // what waits on its way, or for a page that stood still, shows that the line carries: nothing happens by itself then
    const isAlone = commands.link !== "open" || (old !== "" && isSilent(store));
    const placed = found("placed") !== false;
    const position_m = store.last("hand", "position");
    const pressed_n = store.last("hand", "force");
    const scale = this.scaleNow(position_m);
    return {
      link: commands.link,
      linkText: commands.linkText,
      old,
      alone: isAlone && store.source.kind === "live" && store.commands ? aloneText(this.wasHeld, commands.link === "open" ? store.pictureAge : Infinity) : "",
      oldPart: store.source.kind === "live" && !old ? oldPart(store) : "",
      kind: store.source.kind,
      role: store.role,
      hasRig: store.nodes.size > 0,
      // Control for a single act is over before anybody reads of it.
      holdsControl: isMine && store.lease.kept,
      isControlFree: store.lease.holder === "" || (isMine && !store.lease.kept),
      lease: text,
      leaseAction: actions[0]?.text ?? "",
      isStopped: commands.isStopped,
      mayArm: commands.mayArm(now),
      tipMode: String(found("mode") ?? ""),
      tipArmed: found("armed") === true,
      placed,
      runs: Number(store.fact(HAND, "session_s") ?? -1) >= 0,
      program: tip.program,
      wayBack: commands.wayBack?.text ?? "",
      going: commands.goingAt(now)?.text ?? "",
      stays: commands.stays,
      offersHand: hand.isOffered,
      isHeld: hand.isHeld,
      touches: found("in_contact") === true,
      swing_n: (store.source.kind === "live" && swingOf(store)?.peakToPeak) || NaN,
      separation_nm: store.last("tip", "separation") * 1e9,
      travelLeft_m: (store.travel_m?.[1] ?? NaN) - position_m,
      needs_m: Math.max(0, store.last("tip", "separation")) / scale,
      lift_m: tooLow(found("offset_m"), store.last("tip", "base"), found("return_place_m")) / scale,
      isForceLimited: Math.abs(pressed_n) > LIMIT_N - 0.05,
      pressed_n,
      felt_n: store.last("command", "tip_force"),
    };
  }

  /** How far the base is sent for a way of the hand [m/m], by where both are; NaN before the hand has moved. */
  private scaleNow(position_m: number): number {
    const reference_m = referenceOf(this.cockpit.store);
    if (Math.abs(position_m) >= LEAST_OF_SCALE_M && reference_m * position_m > 0) this.scale = reference_m / position_m;
    return this.scale;
  }
}

/** Where the hand sends the base [m], towards the sample: the base with what it stays behind by. */
function referenceOf(store: Store): number {
  return store.last("tip", "base") + Number(store.fact(AFM, "offset_m") ?? 0);
}

/** How much too low the hand is, at the scale of the tip, for hand and tip to meet in the free [m]; 0 where it is not. */
export function tooLow(offset_m: unknown, base_m: number, place_m: unknown): number {
  if (typeof offset_m !== "number" || Number.isNaN(base_m)) return 0;
  return Math.max(0, base_m + offset_m - (typeof place_m === "number" ? place_m : 0));
}

/** What happens by itself while this page is not heard, and has not been for so long [s]. */
export function aloneText(wasHeld: boolean, age_s: number): string {
  if (!wasHeld) return "What other pages and the rig do goes on";
  return age_s < VANISHED_S ? "The hand is being let go" : "This page held the hand: it is let go, and the tip is being withdrawn";
}
