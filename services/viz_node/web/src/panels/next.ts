import type { Cockpit, Panel } from "../cockpit";
import { make, part } from "../dom";
import { LeaseBar, leaseOffer } from "../lease";
import { nextOf, STEPS, stepStates, type Act, type Next, type Offer, type Situation } from "../next";
import { swingOf } from "../state";

const AFM = "afm/state/slave";
const HAND = "haptic/state/master";
/** The time after which numbers in a sentence are renewed [ms]: faster nobody reads them. */
const SAYS_MS = 200;
/** What one press of the button that lowers the hand means [m]. */
const LOWER_M = 0.5e-3;
const NAMES: Record<(typeof STEPS)[number], string> = { connect: "Connect", control: "Take control", arm: "Arm", approach: "Approach", touch: "Touch", "let go": "Let go" };
/** The buttons by which tests and people find what they do. */
const IDS: Partial<Record<Act, string>> = { arm: "arm", "go back": "go-back", stay: "stay", start: "start-next", hold: "hold", lower: "lower", "let go": "let-go", take: "take", "end way": "end-way" };

/** What is done, what is next, and the one filled button that does it. */
export class NextPanel implements Panel {
  readonly lease: LeaseBar;
  private readonly steps = STEPS.map((name) => make("li", {}, NAMES[name]));
  private readonly says = make("p", { id: "next-says", role: "status" });
  private readonly way = make("progress", { max: 1, value: 0, hidden: true, "aria-label": "Way back of the tip" });
  private readonly choices = make("div", { class: "choices", role: "group", "aria-label": "What to do next" });
  private next: Next | undefined;
  private shown = "";
  private state = "";
  private saidAt = -Infinity;

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
    this.draw();
  }

  /** Show what is next, at its time and not with the frames, of which a slow machine draws few. */
  draw(): void {
    const now = performance.now();
    this.lease.write();
    const situation = this.situation(now);
    // while a hand is held its window has control, if nobody took it for longer
    const holds = situation.holdsControl || (situation.isHeld && situation.isControlFree);
    const next = (this.next = nextOf(situation));
    const going = this.cockpit.commands.goingAt(now);
    this.way.hidden = !going;
    if (going) this.way.value = going.share;
    const isLive = this.cockpit.store.source.kind === "live";
    const state = `${next.step}${isLive}${holds}`;
    const key = JSON.stringify([next.offer, next.other]);
    if (state !== this.state || key !== this.shown || now - this.saidAt >= SAYS_MS) {
      this.saidAt = now;
      if (this.says.textContent !== next.says) this.says.textContent = next.says;
    }
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
    const found = [this.next?.offer, this.next?.other].find((offer) => offer?.key === key);
    if (!found?.isReady) return false;
    this.act(found.act);
    return true;
  }

  private button({ act, label, key, isReady }: Offer, isNext: boolean): HTMLButtonElement {
    const id = IDS[act];
    return make("button", { type: "button", ...(id && { id }), class: isNext ? "go" : "", disabled: !isReady, "aria-keyshortcuts": key, title: `Key ${key}`, onclick: () => this.act(act) }, label);
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
      lower: () => hand.lower(LOWER_M),
      "let go": () => hand.letGo(),
    };
    void acts[act]();
  }

  private situation(now: number): Situation {
    const { store, commands, hand, tip } = this.cockpit;
    const { text, actions } = leaseOffer(store.lease, store.me, store.role);
    const isMine = store.lease.holder !== "" && store.lease.holder === store.me;
    const found = (name: string): unknown => store.fact(AFM, name);
    return {
      link: commands.link,
      linkText: commands.linkText,
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
      placed: found("placed") !== false,
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
      pressed_n: store.last("hand", "force"),
      felt_n: store.last("command", "tip_force"),
    };
  }
}
