import type { Connection, LinkState } from "./connection";
import { make, part } from "./dom";
import type { Values } from "./form";
import type { Facts } from "./protocol";
import { Stops } from "./stops";
import type { Store } from "./store";

const SHOWN_MS = 7000;
/** There is room for two lines beside the state of the rig. */
const MOST_SHOWN = 2;
/** The AFM before the haptic device, so that the hand never moves a reference that nothing follows. */
const DEVICES = ["afm_node", "haptic_node"];

/** Commands of the operator; each shows its acknowledgement or its refusal. */
export class Commands {
  readonly stops = new Stops(() => ({
    afm_node: this.store.fact("afm/state/slave", "mode") === "estop",
    haptic_node: this.store.fact("haptic/state/master", "estop") === true,
  }));
  /** Called when an emergency stop is asked for, before it is answered. */
  onEstop: () => void = () => {};
  /** Called before devices are armed: the tip must not press at once with a force that was held before. */
  onArm: () => void = () => {};
  link: LinkState = "connecting";

  constructor(
    private readonly connection: Connection,
    private readonly store: Store,
  ) {}

  /** Whether this page commands anything: it is connected, to a rig, and its person may have the hand. */
  get may(): boolean {
    return this.link === "open" && this.store.role !== "observer" && this.store.commands;
  }

  /** Why the emergency stop of this page stops nothing, and what does; empty where it stops. */
  get deadStop(): { short: string; long: string } | undefined {
    if (this.link !== "open") {
      return { short: "STOP NOT CONNECTED", long: "This page is not connected and stops nothing: use the switch of the instrument, or type: telenano estop" };
    }
    if (this.store.source.kind === "recording") return { short: "NOTHING TO STOP", long: "This is a recording: it moves nothing" };
    return undefined;
  }

  async estop(): Promise<void> {
    const dead = this.deadStop;
    this.stops.note();
    this.onEstop();
    if (dead) this.show("emergency stop", false, dead.long);
    else await this.ask("emergency stop", { k: "estop" });
  }

  async command(about: string, command: string, target: string, parameters: Values = {}): Promise<boolean> {
    return this.ask(about, { k: "command", command, target, parameters, lease: this.store.ownLease });
  }

  /** Arm the devices one after the other, as far as they permit, and no further than to the next emergency stop; the answer says whether all are. */
  async arm(mayGoOn = this.stops.begin()): Promise<boolean> {
    this.onArm();
    for (const device of DEVICES) if (!mayGoOn() || !(await this.command(`arm ${device}`, "arm", device))) return false;
    return true;
  }

  /** Couple hand and tip anew: the tip is withdrawn, and armed when the hand is at rest. */
  async couple(): Promise<boolean> {
    this.onArm();
    return this.command("couple hand and tip", "couple", "*");
  }

  async ask(about: string, fields: Facts): Promise<boolean> {
    const note = this.pending(about);
    const answer = await this.connection.ask(fields);
    this.store.takeLease(answer.lease);
    this.settle(note, about, answer.ok, answer.text);
    return answer.ok;
  }

  /** Show the answer to what needs no server. */
  show(about: string, ok: boolean, text: string): void {
    this.settle(this.pending(about), about, ok, text);
  }

  /** Say something that is neither an acknowledgement nor a refusal. */
  tell(text: string): void {
    const note = this.pending("");
    note.textContent = note.title = text;
    setTimeout(() => note.remove(), SHOWN_MS);
  }

  private pending(about: string): HTMLElement {
    const note = make("div", { class: "answer pending" }, `${about} …`);
    const answers = part("answers");
    answers.prepend(note);
    while (answers.childElementCount > MOST_SHOWN) answers.lastElementChild!.remove();
    return note;
  }

  private settle(note: HTMLElement, about: string, ok: boolean, text: string): void {
    note.className = `answer ${ok ? "done" : "refused"}`;
    note.textContent = note.title = `${about}: ${ok ? "acknowledged" : "refused"} · ${text}`;
    setTimeout(() => note.remove(), SHOWN_MS);
  }
}
