import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { openRecording } from "../recording";

/** The operator's force profile: start, stop, bring hand and tip together again; marks and files of the recording. */
export class SessionPanel implements Panel {
  private readonly start: HTMLButtonElement;
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
    this.start.title = "Begin the session: the tip follows the hand, and the force profile of a simulated operator starts";
    stop.title = "End the session: the hand is let go; the recording continues";
    const couple = button("couple", "Meet again", () => commands.couple());
    couple.title = "Remove an offset between hand and tip (o): the tip is withdrawn, and comes back to where the hand is";
    this.mark = make("input", { id: "mark-text", type: "text", placeholder: "Text of a mark", "aria-label": "Text of the mark", maxlength: 200 });
    this.mark.addEventListener("keydown", (event) => event.key === "Enter" && void this.setMark());
    const mark = button("mark", "Mark", () => this.setMark());
    const split = button("split", "New file", () => commands.command("begin a new file", "set", "recorder", { "record.split": true }));
    // one list of files for both places where a person looks for them
    const save = make("button", { type: "button", id: "save-recording", onclick: () => openRecording() }, "Save the recording");
    this.buttons = [this.start, stop, couple, mark, split];
    const programme = make("div", { class: "segments", role: "group", "aria-label": "Force profile of the operator" }, this.start, stop);
    root.append(make("div", { class: "row tight" }, programme, make("span", { class: "spacer" }), couple), make("div", { class: "row tight" }, this.mark, mark, make("details", { class: "menu", id: "file-more" }, make("summary", { "aria-label": "More of the recording" }, "⋯"), make("div", { class: "sheet" }, split, save))));
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
  }

  private setMark(): Promise<boolean> {
    return this.cockpit.commands.command("mark", "mark", "recorder", { text: this.mark.value || "mark" });
  }
}
