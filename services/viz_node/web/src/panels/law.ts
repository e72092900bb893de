import type { Cockpit, Panel } from "../cockpit";
import { CycleCounter } from "../cycles";
import { make } from "../dom";
import { swingOf } from "../state";
import { fixed } from "../numbers";

/** The law of the loop. Its parameters are among the settings. */
export class LawPanel implements Panel {
  private readonly select = make("select", { id: "law-name", "aria-label": "Law" });
  private readonly facts = make("span", { class: "quiet" });
  private shown = "";
  private cycles = new CycleCounter();

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    this.facts.title = ENERGY_ABOUT;
    this.select.title = "The control law: how it joins hand and tip over the delay";
    root.querySelector("h2")?.append(this.facts);
    root.append(make("div", { class: "row tight" }, this.select));
    this.select.addEventListener("change", () => {
      void this.cockpit.commands.command(`law ${this.select.value}`, "set", "controller", { law: this.select.value }).then((ok) => {
        if (!ok) this.select.value = this.shown;
      });
    });
  }

  begin(): void {
    const { store, commands } = this.cockpit;
    const laws = (store.forms["laws"] ?? []) as string[];
    this.select.replaceChildren(...laws.map((law) => make("option", { value: law }, law.replaceAll("_", " "))));
    this.select.disabled = !commands.may;
    this.shown = "";
    this.write();
  }

  write(): void {
    const { store } = this.cockpit;
    const law = String(store.fact("law/status/master", "law") ?? "");
    if (law && law !== this.shown) {
      this.shown = law;
      this.select.value = law;
      // what a law loses a little of in each cycle shows in many of its own
      this.cycles = new CycleCounter();
    }
    this.cycles.see(store.last("hand", "force"));
    const passive = store.fact("law/status/master", "passive");
    const age = store.last("hand", "loop_age");
    const swings = swingOf(store) !== undefined;
    // of a motion that swings nothing is to be read but where its energy comes from
    const words = swings && passive === true ? [energyText(passive, swings)] : [
      Number.isNaN(age) ? "" : `answers in ${fixed(age * 1e3, age < 0.1 ? 1 : 0)} ms`,
      energyText(passive),
      `${this.cycles.count} ${this.cycles.count === 1 ? "press" : "presses"}`,
    ];
    const text = words.filter(Boolean).join(" · ");
    if (this.facts.textContent !== text) this.facts.textContent = text;
  }
}

/** What the account of the energy says, and of a motion that swings all the same where its energy comes from. */
export function energyText(passive: unknown, swings = false): string {
  if (passive !== true) return passive === false ? "has added energy" : "";
  return swings ? "adds none: the hand's energy keeps it swinging" : "adds no energy";
}

const ENERGY_ABOUT =
  "The loop has given out no more energy at its two ports than it took in. It can still swing: hand, sample and delay oscillate for long on the energy that the hand puts in, and a red OSCILLATES shows that.";
