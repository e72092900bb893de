import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";

/** The operator's force profile and the devices: start, stop, couple again, arm; marks and files of the recording. */
export class SessionPanel implements Panel {
  private readonly start: HTMLButtonElement;
  private readonly armed: HTMLButtonElement;
  private readonly back: HTMLButtonElement;
  private readonly mark: HTMLInputElement;
  private readonly buttons: HTMLButtonElement[];

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const { commands } = cockpit;
    const button = (id: string, text: string, action: () => Promise<unknown>): HTMLButtonElement =>
      make("button", { type: "button", id, onclick: () => void action() }, text);
    this.start = button("start", "Start", () => commands.command("start", "start", "haptic_node"));
    const stop = button("stop", "Stop", () => commands.command("stop", "stop", "haptic_node"));
    this.armed = button("arm", "Arm", () => commands.arm());
    this.armed.title = "Arm hand and tip: both stay where they are";
    this.back = button("go-back", "Go back", () => commands.goBack());
    this.back.title = "Let the tip go back (g): any key, any press and any command ends it";
    this.back.hidden = true;
    const couple = button("couple", "Couple", () => commands.couple());
    couple.title = "Couple hand and tip again (o): the tip is withdrawn, and comes back to where the hand is";
    this.mark = make("input", { id: "mark-text", type: "text", placeholder: "Text of a mark", "aria-label": "Text of the mark", maxlength: 200 });
    this.mark.addEventListener("keydown", (event) => event.key === "Enter" && void this.setMark());
    const mark = button("mark", "Mark", () => this.setMark());
    const split = button("split", "New file", () => commands.command("begin a new file", "set", "recorder", { "record.split": true }));
    this.buttons = [this.start, stop, couple, this.armed, this.back, mark, split];
    const programme = make("div", { class: "segments", role: "group", "aria-label": "Force profile of the operator" }, this.start, stop);
    root.append(make("div", { class: "row tight" }, programme, make("span", { class: "spacer" }), couple, this.armed), this.back, make("div", { class: "row tight" }, this.mark, mark, split));
  }

  begin(): void {
    const may = this.cockpit.commands.may;
    for (const button of this.buttons) button.disabled = !may;
    this.mark.disabled = !may;
  }

  /** What runs is the pressed button. */
  write(): void {
    const { store } = this.cockpit;
    const runs = Number(store.fact("haptic/state/master", "session_s") ?? -1) >= 0;
    const { isStopped } = this.cockpit.commands;
    const isKnown = store.state.has("haptic/state/master");
    // the force profile of the operator continues behind an emergency stop, and nothing follows it
    this.start.setAttribute("aria-pressed", String(runs && !isStopped));
    this.start.nextElementSibling!.setAttribute("aria-pressed", String(isKnown && !runs));
    this.armed.setAttribute("aria-pressed", String(isKnown && !isStopped && store.fact("haptic/state/master", "mode") !== "safe"));
    this.writeWayBack();
  }

  /** The second choice after an arming, with its numbers; it is there only while the instrument states them. */
  private writeWayBack(): void {
    const { wayBack, isStopped } = this.cockpit.commands;
    this.back.hidden = !wayBack || isStopped;
    if (wayBack && this.back.textContent !== wayBack.text) this.back.textContent = wayBack.text;
  }

  private setMark(): Promise<boolean> {
    return this.cockpit.commands.command("mark", "mark", "recorder", { text: this.mark.value || "mark" });
  }
}
