import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { faultLine, faultOf, judge } from "../field";
import { whyWithdrawn } from "../guard";
import { programAbout, programName } from "../programs";
import { programsOf } from "../schema";
import { plain } from "../sentences";
import { INSTRUMENT, place } from "../tip";
import { fixed } from "../numbers";

/** What the guard's modes mean to an operator. */
const MODES: Record<string, string> = {
  follow: "The tip follows the hand, and the hand feels the tip.",
  hold: "The tip holds its place: no fresh command comes.",
  retracted: "The tip is withdrawn. Arm it, and then let it go back.",
  retracting: "The tip moves away from the sample.",
  estop: "Emergency stop: the tip is withdrawn. Arm ends the stop; the tip stays until you let it go back.",
};
const FARTHEST_NM = 1e5;

/** What the instrument does, as one pressed button of several, and where the tip is over the sample. */
export class InstrumentPanel implements Panel {
  private readonly modes = make("div", { class: "segments", role: "group", "aria-label": "Mode of the instrument" });
  private readonly run = make("div", { class: "segments", role: "group", "aria-label": "The program that runs" });
  private readonly state = make("div", { class: "quiet", id: "program-state" });
  private readonly places: HTMLInputElement[];
  private readonly fault: HTMLElement;
  private readonly go: HTMLButtonElement;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const field = (axis: string): HTMLInputElement => make("input", { id: `tip-${axis}`, type: "text", inputmode: "decimal", placeholder: axis, "aria-label": `${axis} of the tip in nm` });
    this.places = ["x", "y"].map(field);
    this.fault = faultLine(this.places[0]!);
    this.go = make("button", { type: "button", id: "tip-go", onclick: () => this.move() }, "Move");
    for (const input of this.places) input.addEventListener("keydown", (event) => event.key === "Enter" && this.move());
    const row = make("div", { class: "row tight tip-place" }, make("span", {}, "Tip to"), ...this.places, make("span", { class: "quiet" }, "nm"), this.go);
    root.append(this.modes, this.state, make("div", { class: "row tight" }, this.run), row, this.fault);
  }

  begin(): void {
    const { commands, store, tip, image } = this.cockpit;
    if (!tip.isThere) return;
    const may = commands.may;
    const button = (id: string, text: string, action: () => unknown): HTMLButtonElement => make("button", { type: "button", id, disabled: !may, "aria-pressed": "false", onclick: () => void action() }, text);
    const programs = programsOf(store.forms[INSTRUMENT] as Record<string, unknown>);
    this.modes.replaceChildren(
      button("mode-bilateral", "By hand", () => tip.followHand()),
      ...programs.map(({ name, title }) => explained(button(`program-${name}`, programName(name, short(title)), () => image.begin(name)), programAbout(name, title))),
    );
    const simple = (name: string, text: string): HTMLButtonElement => button(`program-${name}`, text, () => commands.command(name, "set", INSTRUMENT, { program: name }));
    this.modes.firstElementChild!.setAttribute("title", "The tip follows the hand, and the hand feels the tip");
    this.run.replaceChildren(...["pause", "resume", "abort"].map((name) => simple(name, name[0]!.toUpperCase() + name.slice(1))));
    for (const input of [...this.places, this.go]) input.disabled = !may;
  }

  write(): void {
    const { store, tip, commands } = this.cockpit;
    const program = store.facts("afm/program/slave") as { program: string; text: string; state: string; done_percent: number } | undefined;
    const mode = String(store.fact("afm/state/slave", "mode") ?? "");
    const running = tip.program;
    for (const button of this.modes.children) {
      const name = button.id.replace("program-", "");
      button.setAttribute("aria-pressed", String(running ? name === running : name === "mode-bilateral" && mode === "follow"));
    }
    for (const button of this.run.children as Iterable<HTMLButtonElement>) {
      const isFit = button.id === "program-resume" ? program?.state === "paused" : button.id === "program-pause" ? program?.state === "running" : running !== "";
      button.disabled = !commands.may || !(running && isFit);
    }
    this.run.parentElement!.hidden = !running;
    const away = whyWithdrawn(store.events);
    let shown = MODES[mode] ?? "";
    if (mode === "follow" && commands.wayBack) shown = "The tip stays where it was armed, and the hand moves it from there.";
    if (program && running) shown = `${programName(program.program)} ${program.state === "paused" ? "is paused" : "runs"}, ${fixed(program.done_percent, 0)} %: ${plain(program.text)}`;
    else if (mode.startsWith("retract")) shown = away ? `${away[0]!.toUpperCase()}${away.slice(1)}: the tip is withdrawn. Arm it, and then let it go back.` : (program?.text ? `${plain(program.text)[0]!.toUpperCase()}${plain(program.text).slice(1)}. Arm it, and then let it go back.` : shown);
    if (this.state.textContent !== shown) this.state.textContent = shown;
  }

  private move(): void {
    const [x, y] = this.places as [HTMLInputElement, HTMLInputElement];
    const wrong = this.places.find((input) => input.value.trim() === "" || faultOf(input.value, -FARTHEST_NM, FARTHEST_NM, "nm"));
    for (const input of this.places) judge(input, this.fault, "");
    if (wrong) judge(wrong, this.fault, faultOf(wrong.value, -FARTHEST_NM, FARTHEST_NM, "nm") || `${wrong === x ? "x" : "y"} is missing`);
    else void this.cockpit.commands.command(`move the tip to ${x.value}, ${y.value} nm`, "set", INSTRUMENT, place(Number(x.value), Number(y.value)));
  }
}

function explained(button: HTMLButtonElement, words: string): HTMLButtonElement {
  button.title = words;
  return button;
}

/** A title that has room in a row of buttons. */
function short(title: string): string {
  return title.replace(/^Force c/, "C").replace(/ path$/, "");
}
