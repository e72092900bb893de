import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { LeaseBar } from "../lease";

/** One unit for one quantity: a number that changes its prefix cannot be read at a glance. */
const FACTS: readonly (readonly [name: string, stream: string, column: string, factor: number, unit: string])[] = [
  ["Hand", "hand", "position", 1e3, "mm"],
  ["Force on the tip", "tip", "force", 1e9, "nN"],
  ["Tip to sample", "tip", "separation", 1e9, "nm"],
  ["Deflection", "tip", "deflection", 1e9, "nm"],
];
const AFM = "afm/state/slave";
const FORCE_TITLE = "It feels from the tip";
/** Below this a force is that of the read-out, and shown as none [N]. */
const LEAST_N = 0.005;

/** The force of the hand and the force that comes back, large; the pad of the virtual hand; and the tip in numbers. */
export class HandPanel implements Panel {
  private readonly own = make("b", { id: "hand-force" }, "–");
  private readonly felt = make("b", { id: "felt-force" }, "–");
  private readonly feltTitle = make("h3", { id: "felt-title" }, FORCE_TITLE);
  private readonly names = FACTS.map(([name]) => make("dt", {}, name));
  private readonly values = FACTS.map(() => make("dd", {}, "–"));
  private readonly control: HTMLElement;
  readonly lease: LeaseBar;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const { hand } = cockpit;
    const number = (kind: string, title: HTMLElement, value: HTMLElement): HTMLElement => make("div", { class: `number ${kind}` }, title, make("div", { class: "big" }, value, make("span", {}, "N")));
    this.lease = new LeaseBar(cockpit.commands, cockpit.store);
    this.control = make("div", { class: "row tight" }, hand.keepButton);
    root.append(
      this.lease.root,
      make("div", { class: "numbers" }, number("own", make("h3", {}, "The hand presses with"), this.own), number("felt", this.feltTitle, this.felt)),
      hand.pad,
      hand.text,
      this.control,
      make("dl", { "aria-label": "Tip now" }, ...FACTS.flatMap((_, i) => [this.names[i]!, this.values[i]!])),
    );
  }

  begin(): void {
    const { hand } = this.cockpit;
    for (const part of [hand.text, this.control]) part.hidden = !hand.isOffered;
    hand.begin();
    this.lease.write();
  }

  frame(): void {
    this.cockpit.hand.draw();
  }

  write(): void {
    const { store } = this.cockpit;
    this.lease.write();
    show(this.own, force(store.last("hand", "force")));
    show(this.felt, force(store.last("command", "tip_force")));
    const channel = feltChannel(store.fact(AFM, "felt_channel"), store.fact(AFM, "felt_clamp"));
    show(this.feltTitle, channel === "" ? FORCE_TITLE : `It feels ${channel}`);
    show(this.names[1]!, channel === "" ? FACTS[1]![0] : "Felt, no force");
    FACTS.forEach(([, stream, column, factor, unit], i) => {
      const value = store.last(stream, column) * factor;
      show(this.values[i]!, Number.isNaN(value) ? "–" : `${(Math.abs(value) < 0.005 ? 0 : value).toFixed(2)} ${unit}`);
    });
  }
}

/** Say which channel is felt in the place of the force, and what limits it; nothing where the force is felt. */
export function feltChannel(channel: unknown, clamp: unknown): string {
  if (typeof channel !== "string") return "";
  const limit = typeof clamp === "string" && clamp !== "" ? `, ${clamp}` : "";
  return `the ${channel.replace("_", " ")}, no force${limit}`;
}

function force(value: number): string {
  if (Number.isNaN(value)) return "–";
  return Math.abs(value) < LEAST_N ? "0.00" : value.toFixed(2);
}

function show(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}
