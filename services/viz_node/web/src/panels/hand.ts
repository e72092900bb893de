import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { GapPicture } from "../gap";
import { fixed, forceText } from "../numbers";

/** One unit for one quantity: a number that changes its prefix cannot be read at a glance. */
const FACTS: readonly (readonly [name: string, stream: string, column: string, factor: number, unit: string])[] = [
  ["Hand", "hand", "position", 1e3, "mm"],
  ["Force on the tip", "tip", "force", 1e9, "nN"],
  ["Tip to sample", "tip", "separation", 1e9, "nm"],
  ["Cantilever bent", "tip", "deflection", 1e9, "nm"],
];
const AFM = "afm/state/slave";
const FORCE_TITLE = "You feel";

/** What the hand presses with and what comes back, large; hand and tip side by side; and the tip in numbers. */
export class HandPanel implements Panel {
  private readonly own = make("b", { id: "hand-force" }, "–");
  private readonly felt = make("b", { id: "felt-force" }, "–");
  private readonly feltTitle = make("h3", { id: "felt-title" }, FORCE_TITLE);
  private readonly names = FACTS.map(([name]) => make("dt", {}, name));
  private readonly values = FACTS.map(() => make("dd", {}, "–"));
  private readonly control: HTMLElement;
  private readonly gap: GapPicture;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const { hand } = cockpit;
    this.gap = new GapPicture(cockpit.store);
    const number = (kind: string, title: HTMLElement, value: HTMLElement): HTMLElement => make("div", { class: `number ${kind}` }, title, make("div", { class: "big" }, value, make("span", {}, "N")));
    this.control = make("div", { class: "row tight holding" }, hand.text, hand.keepButton);
    root.append(
      make(
        "div",
        { class: "figures" },
        make("div", { class: "numbers" }, number("own", make("h3", {}, "You press"), this.own), number("felt", this.feltTitle, this.felt)),
        make("dl", { "aria-label": "Tip now" }, ...FACTS.flatMap((_, i) => [this.names[i]!, this.values[i]!])),
      ),
      make("div", { class: "pictures" }, make("div", { class: "picture" }, make("h3", {}, "Hand"), hand.pad), make("div", { class: "picture" }, make("h3", {}, "Tip over the sample"), this.gap.root)),
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
  }
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
