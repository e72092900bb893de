import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { GapPicture } from "../gap";
import { ageWords } from "../freshness";
import { limitsOf, limitsText, travelText } from "../limits";
import { fixed, forceText } from "../numbers";
import type { Felt } from "../socket.worker";

/** One unit for one quantity: a number that changes its prefix cannot be read at a glance. */
const FACTS: readonly (readonly [name: string, stream: string, column: string, factor: number, unit: string])[] = [
  ["Hand", "hand", "position", 1e3, "mm"],
  ["Force on the tip", "tip", "force", 1e9, "nN"],
  ["Tip to sample", "tip", "separation", 1e9, "nm"],
  ["Cantilever bent", "tip", "deflection", 1e9, "nm"],
];
const AFM = "afm/state/slave";
const HAND = "haptic/state/master";
/** For so long after the last answer to the hand its age is shown [ms]. */
const FELT_MS = 1000;
const FORCE_TITLE = "You feel";

/** What the hand presses with and what comes back, large; hand and tip side by side; and the tip in numbers. */
export class HandPanel implements Panel {
  private readonly own = make("b", { id: "hand-force" }, "–");
  private readonly felt = make("b", { id: "felt-force" }, "–");
  private readonly feltTitle = make("h3", { id: "felt-title" }, FORCE_TITLE);
  private readonly names = FACTS.map(([name]) => make("dt", {}, name));
  private readonly values = FACTS.map(() => make("dd", {}, "–"));
  private readonly control: HTMLElement;
  /** What hand and tip are kept from going beyond, and what the hand has left of its travel. */
  private readonly limits = make("p", { id: "limits", class: "warning", role: "status", hidden: true });
  private limitsBefore = "";
  /** How old the force is that this page is told in answer to its hand, and by which way. */
  private readonly age = make("p", { id: "felt-age", class: "quiet", hidden: true });
  private readonly travel = make("span", { id: "travel", class: "quiet" });
  /** What is made of each stream: grey, with its age, where that is not of the present. */
  private readonly made: [element: HTMLElement, stream: string, age: HTMLElement][];
  private readonly gap: GapPicture;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const { hand } = cockpit;
    this.gap = new GapPicture(cockpit.store);
    const number = (kind: string, title: HTMLElement, value: HTMLElement): HTMLElement => make("div", { class: `number ${kind}` }, title, make("div", { class: "big" }, value, make("span", {}, "N")));
    this.control = make("div", { class: "row tight holding" }, hand.text, hand.keepButton);
    const age = (): HTMLElement => make("span", { class: "age", hidden: true });
    const titled = (title: string, shown: HTMLElement, stream: string, more: Node | string = ""): HTMLElement => {
      const [of, picture] = [age(), make("div", { class: "picture" })];
      picture.append(make("h3", {}, title, " ", more, of), shown);
      this.made.push([picture, stream, of]);
      return picture;
    };
    const [own, felt] = [number("own", make("h3", {}, "You press"), this.own), number("felt", this.feltTitle, this.felt)];
    const numbers = make("dl", { "aria-label": "Tip now" }, ...FACTS.flatMap((_, i) => [this.names[i]!, this.values[i]!]));
    this.made = [[own, "hand", age()], [felt, "command", age()], [numbers, "tip", age()]];
    for (const [element, , of] of this.made) element.append(of);
    root.append(
      make("div", { class: "figures" }, make("div", { class: "numbers" }, own, felt), numbers),
      make("div", { class: "pictures" }, titled("Hand", hand.pad, "hand", this.travel), titled("Tip over the sample", this.gap.root, "tip")),
      this.limits,
      this.age,
      this.control,
    );
  }

  begin(): void {
    const { hand } = this.cockpit;
    this.control.hidden = !hand.isOffered;
    hand.begin();
  }

  frame(): void {
    this.cockpit.hand.draw();
    this.gap.draw();
  }

  recolour(): void {
    this.gap.invalidate();
  }

  write(): void {
    const { store } = this.cockpit;
    show(this.own, forceText(store.last("hand", "force")));
    show(this.felt, forceText(store.last("command", "tip_force")));
    const channel = feltChannel(store.fact(AFM, "felt_channel"), store.fact(AFM, "felt_clamp"));
    show(this.feltTitle, channel === "" ? FORCE_TITLE : `You feel ${channel}`);
    show(this.names[1]!, channel === "" ? FACTS[1]![0] : "Felt, no force");
    FACTS.forEach(([, stream, column, factor, unit], i) => {
      const value = store.last(stream, column) * factor;
      show(this.values[i]!, Number.isNaN(value) ? "–" : `${fixed(value, 2)} ${unit}`);
    });
    this.gap.write();
    const travel = travelText(store.last("hand", "position"), store.travel_m);
    show(this.travel, travel.short);
    if (this.travel.title !== travel.long) this.travel.title = travel.long;
    const limits = store.isPictureOld ? "" : limitsText(limitsOf(store.fact(HAND, "limited_by"), store.fact(AFM, "limited_by"), store.fact(AFM, "felt_clamp"), store.fact(AFM, "placed") !== false));
    // a limit may act for a sample alone: what lasts is shown
    if (limits === this.limitsBefore) {
      show(this.limits, limits);
      this.limits.hidden = limits === "";
    }
    this.limitsBefore = limits;
    const age = feltAge(store.felt, performance.now());
    show(this.age, age);
    this.age.hidden = age === "";
    for (const [element, stream, of] of this.made) {
      const isOld = store.isPictureOld || store.isOld(stream);
      element.toggleAttribute("data-old", isOld);
      of.hidden = !isOld;
      if (isOld) show(of, `${ageWords(Math.max(store.pictureAge, store.age_s(stream) || 0))} old`);
    }
  }
}

/** Say how old the force is that answers the hand of this page, and by which way it came; nothing where none has come just now [ms]. */
export function feltAge(felt: (Felt & { at: number }) | undefined, now: number): string {
  if (!felt || now - felt.at > FELT_MS) return "";
  return `The force is ${Math.round(1e3 * felt.age_s)} ms old, by ${felt.isDatagram ? "datagrams" : "the web socket"}`;
}

/** Say which channel is felt in the place of the force, and what limits it; nothing where the force is felt. */
export function feltChannel(channel: unknown, clamp: unknown): string {
  if (typeof channel !== "string") return "";
  const limit = typeof clamp === "string" && clamp !== "" ? `, ${clamp}` : "";
  return `the ${channel.replace("_", " ")}, no force${limit}`;
}

function show(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}
