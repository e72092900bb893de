import type { Controls } from "./controls";
import { make, part } from "./dom";
import { Form, type Values } from "./form";
import { programsOf, settings } from "./schema";
import type { Store } from "./store";

const NM = 1e-9;
const TARGET = "afm_node";
const PROGRAM = "afm/program/slave";
/** What the guard's modes mean to an operator. */
const MODES: Record<string, string> = {
  follow: "Mode bilateral: the tip follows the hand.",
  hold: "Mode hold: the tip stays where it is, because no fresh command comes.",
  retracted: "Mode retracted: the tip is away from the sample. Bilateral, or Arm, brings it back.",
  retracting: "Mode retracting: the tip moves away from the sample.",
  estop: "Emergency stop: the tip is away from the sample. Arm brings it back.",
};
const LOOK_MS = 100;
const LONGEST_END_MS = 5000;

/** What the instrument does by itself: images and force curves, and where the tip is over the sample. */
export class Instrument {
  private readonly state = make("div", { class: "quiet", id: "program-state" }, "");
  private wanted: [number, number] | undefined;
  private isSending = false;

  constructor(
    private readonly controls: Controls,
    private readonly store: Store,
  ) {}

  /** Whether the nodes have said what the instrument takes. */
  get isThere(): boolean {
    return this.store.commands && "afm_node" in this.store.forms;
  }

  build(): void {
    const root = part("instrument");
    root.hidden = !this.isThere;
    if (!this.isThere) return;
    const may = this.store.role === "operator";
    const schema = this.store.forms["afm_node"] as Record<string, unknown>;
    const button = (id: string, text: string, action: () => unknown): HTMLButtonElement => make("button", { type: "button", id, disabled: !may, onclick: () => void action() }, text);
    const simple = (name: string, text: string): HTMLButtonElement => button(`program-${name}`, text, () => this.controls.command(name, "set", TARGET, { program: name }));
    const programs = programsOf(schema).map(({ name, title }) => ({ name, title, form: new Form(settings(schema, name), "program") }));
    const begin = (program: string, form: Form) => () => this.controls.command(`${program} begins`, "set", TARGET, { program, ...form.values() });
    const field = (id: string, label: string): HTMLInputElement => make("input", { id, type: "number", step: "any", placeholder: label, "aria-label": `${label} of the tip in nm`, disabled: !may });
    const [x, y] = [field("tip-x", "x"), field("tip-y", "y")];
    const go = (): void => {
      if (x.value === "" || y.value === "") return;
      void this.controls.command(`tip to ${x.value}, ${y.value} nm`, "set", TARGET, place(Number(x.value), Number(y.value)));
    };
    root.replaceChildren(
      make("h2", {}, "Instrument"),
      make("div", { class: "row", role: "group", "aria-label": "Mode of the instrument" }, button("mode-bilateral", "Bilateral", () => this.followHand()), ...programs.map(({ name, title, form }) => button(`program-${name}`, title, begin(name, form)))),
      make("div", { class: "row" }, simple("pause", "Pause"), simple("resume", "Resume"), simple("abort", "Abort")),
      this.state,
      make("div", { class: "row tip-place" }, "Tip", x, y, "nm", button("tip-go", "Move", go)),
      ...programs.map(({ title, form }) => make("details", {}, make("summary", {}, `Settings: ${title.toLowerCase()}`), form.element)),
    );
  }

  draw(): void {
    const program = this.store.state.get(PROGRAM) as { program: string; text: string; state: string; done_percent: number } | undefined;
    const mode = MODES[String(this.store.fact("afm/state/slave", "mode") ?? "")] ?? "";
    let shown = mode;
    if (program && this.runsProgram) shown = `Mode ${program.program}: ${program.state}, ${program.done_percent.toFixed(0)} %: ${program.text}`;
    else if (program?.text) shown += ` Before: ${program.text}.`;
    if (this.state.textContent !== shown) this.state.textContent = shown;
  }

  private get runsProgram(): boolean {
    return ["running", "paused"].includes(String(this.store.fact(PROGRAM, "state")));
  }

  /** End a program, wait until the tip is away, and let it follow the hand again. */
  private async followHand(): Promise<void> {
    const mayGoOn = this.controls.stops.begin();
    if (this.runsProgram && !(await this.controls.command("abort", "set", TARGET, { program: "abort" }))) return;
    const isEnding = (): boolean => this.runsProgram || this.store.fact("afm/state/slave", "mode") === "retracting";
    for (let waited = 0; isEnding() && waited < LONGEST_END_MS; waited += LOOK_MS) await new Promise((go) => setTimeout(go, LOOK_MS));
    await this.controls.arm(mayGoOn);
  }

  /** Move the tip over the sample as the pointer goes [nm]: one command at a time, and then to the newest place. */
  moveTo(x: number, y: number): void {
    this.wanted = [x, y];
    if (!this.isSending) void this.send();
  }

  private async send(): Promise<void> {
    this.isSending = true;
    while (this.wanted) {
      const [x, y] = this.wanted;
      this.wanted = undefined;
      await this.controls.command(`tip to ${x.toFixed(2)}, ${y.toFixed(2)} nm`, "set", TARGET, place(x, y));
    }
    this.isSending = false;
  }
}

function place(x: number, y: number): Values {
  return { "lateral.x_m": x * NM, "lateral.y_m": y * NM };
}
