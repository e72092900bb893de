import type { Cockpit, Panel } from "../cockpit";
import { make, part } from "../dom";
import { LeaseBar, leaseOffer } from "../lease";
import { LIMIT_N } from "../spring";
import { lowerBy, nextOf, STEPS, stepStates, type Act, type Next, type Offer, type Situation } from "../next";
import { oldPart, oldWords, swingOf } from "../state";

const AFM = "afm/state/slave";
const HAND = "haptic/state/master";
/** A page that held the hand and is not heard for this long has lost control, and the tip is withdrawn [s]. */
const VANISHED_S = 1;
/** The keys that do the same as the one of an act: `n` is that of the filled button. */
const KEYS: Partial<Record<Act, string>> = { take: "h", "go back": "g", "let go": "u" };
/** A smaller way of the hand says nothing of the scale between hand and tip [m]. */
const LEAST_OF_SCALE_M = 2e-3;
const NAMES: Record<(typeof STEPS)[number], string> = { connect: "Connect", control: "Take control", arm: "Arm", approach: "Approach", touch: "Touch", "let go": "Let go" };
/** The buttons by which tests and people find what they do. */
const IDS: Partial<Record<Act, string>> = { arm: "arm", "go back": "go-back", stay: "stay", start: "start-next", hold: "hold", lower: "lower", lift: "lift", "let go": "let-go", take: "take", "end way": "end-way" };

/** What is done, what is next, and the one filled button that does it. */
export class NextPanel implements Panel {
  readonly lease: LeaseBar;
  private readonly steps = STEPS.map((name) => make("li", {}, NAMES[name]));
  private readonly says = make("p", { id: "next-says", role: "status" });
  private readonly way = make("progress", { max: 1, value: 0, hidden: true, "aria-label": "Way back of the tip" });
  private readonly choices = make("div", { class: "choices", role: "group", "aria-label": "What to do next" });
  private next: Next | undefined;
  private situation: Situation | undefined;
  private shown = "";
  private state = "";
  /** Whether this page held the hand when it was last heard, and the base goes so far for a way of the hand [m/m]. */
  private wasHeld = false;
  private scale = NaN;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    this.lease = new LeaseBar(cockpit.commands, cockpit.store);
    part("control").append(this.lease.root);
    root.append(make("div", { class: "leads" }, make("ol", { class: "steps", "aria-label": "Steps" }, ...this.steps), this.says, this.way), this.choices);
  }

  begin(): void {
    this.shown = this.state = "";
    this.look(performance.now());
    this.write();
  }

  /** See what is next in the instant that is shown, at a time [ms]; return what of it is seen at once, without its numbers. */
  look(now: number): string {
    const situation = (this.situation = this.situationAt(now));
    const next = (this.next = nextOf(situation));
    return JSON.stringify([next.step, next.offer, next.other, next.says.replace(/-?[\d.]+/g, "")]);
  }

  /** Write what is next, with all other words of the same instant. */
  write(): void {
    const { next, situation } = this;
    if (!next || !situation) return;
    this.lease.write();
    const holds = situation.holdsControl || (situation.isHeld && situation.isControlFree);
    const going = this.cockpit.commands.goingAt(performance.now());
    this.way.hidden = !going;
    if (going) this.way.value = going.share;
    const isLive = this.cockpit.store.source.kind === "live";
    const state = `${next.step}${isLive}${holds}`;
    const key = JSON.stringify([next.offer, next.other]);
    if (this.says.textContent !== next.says) this.says.textContent = next.says;
    if (state !== this.state) {
      this.state = state;
      const states = stepStates(next.step, holds);
      this.steps[0]!.parentElement!.hidden = !isLive || next.step === "";
      STEPS.forEach((name, i) => {
        const item = this.steps[i]!;
        item.dataset["state"] = states[name];
        if (states[name] === "next") item.setAttribute("aria-current", "step");
        else item.removeAttribute("aria-current");
        item.textContent = `${states[name] === "done" ? "✓ " : ""}${NAMES[name]}`;
      });
    }
    if (key === this.shown) return;
    this.shown = key;
    const had = this.choices.contains(document.activeElement) ? document.activeElement : undefined;
    const made = [next.other, next.offer].filter((found) => found !== undefined).map((found) => this.button(found, found === next.offer));
    this.choices.replaceChildren(...made);
    // A person who works by the keyboard stays here; of two choices the focus has the one that moves nothing.
    if (had) made[0]?.focus();
  }

  /** Do what is next by a key, live and where it may be done; whether the key was one of it. */
  key(key: string): boolean {
    const found = [this.next?.offer, this.next?.other].find((offer) => offer && (offer.key === key || KEYS[offer.act] === key));
    if (!found?.isReady) return false;
    this.act(found.act);
    return true;
  }

  private button({ act, label, key, isReady, why }: Offer, isNext: boolean): HTMLButtonElement {
    const id = IDS[act];
    return make("button", { type: "button", ...(id && { id }), class: isNext ? "go" : "", disabled: !isReady, "aria-keyshortcuts": key, title: why || `Key ${key}`, onclick: () => this.act(act) }, label);
  }

  private act(act: Act): void {
    const { commands, hand } = this.cockpit;
    // whatever is drawn by now, right after a stop nothing arms
    if (act === "arm" && !commands.mayArm(performance.now())) return;
    const acts: Record<Act, () => unknown> = {
      reload: () => location.reload(),
      take: () => this.lease.first(),
      arm: () => commands.arm(),
      start: () => commands.command("start", "start", "haptic_node"),
      "by hand": () => this.cockpit.tip.followHand(),
      stay: () => commands.stay(),
      "go back": () => commands.goBack(),
      // the press itself has ended it
      "end way": () => undefined,
      hold: () => {
        hand.holdHere();
        hand.pad.focus();
      },
      lower: () => hand.lower(lowerBy(this.situation?.touches ? NaN : (this.situation?.needs_m ?? NaN))),
      lift: () => hand.lift(this.situation?.lift_m ?? 0),
      "let go": () => hand.letGo(),
    };
    void acts[act]();
  }

  private situationAt(now: number): Situation {
    const { store, commands, hand, tip } = this.cockpit;
    const { text, actions } = leaseOffer(store.lease, store.me, store.role);
    const isMine = store.lease.holder !== "" && store.lease.holder === store.me;
    const found = (name: string): unknown => store.fact(AFM, name);
    const old = store.isPictureOld ? oldWords(store) : "";
    if (commands.link === "open" && !old) this.wasHeld = hand.isHeld;
    const isAlone = commands.link !== "open" || old !== "";
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
function referenceOf(store: Cockpit["store"]): number {
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
