import type { Cockpit, Panel } from "../cockpit";
import { make, part } from "../dom";
import { LeaseBar } from "../lease";
import { lowerBy, nextOf, STEPS, stepStates, type Act, type Next, type Offer, type Situation } from "../next";
import { Situations } from "../situation";

/** The keys that do the same as the one of an act: `n` is that of the filled button. */
const KEYS: Partial<Record<Act, string>> = { take: "h", "go back": "g", "let go": "u" };
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
  private readonly situations: Situations;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    this.situations = new Situations(cockpit);
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
    const situation = (this.situation = this.situations.at(now));
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
}
