import type { Commands } from "./commands";
import type { Values } from "./form";
import type { Store } from "./store";
import { fixed } from "./numbers";

const NM = 1e-9;
export const INSTRUMENT = "afm_node";
const PROGRAM = "afm/program/slave";
const LOOK_MS = 100;
const LONGEST_END_MS = 5000;

/** Where the tip is over the sample, and what moves it: the hand, or a program. */
export class Tip {
  private wanted: [number, number] | undefined;
  private isSending = false;

  constructor(
    private readonly commands: Commands,
    private readonly store: Store,
  ) {}

  /** Whether the nodes have said what the instrument takes. */
  get isThere(): boolean {
    return this.store.commands && INSTRUMENT in this.store.forms;
  }

  /** The program that runs or pauses; empty where none does. */
  get program(): string {
    const runs = ["running", "paused"].includes(String(this.store.fact(PROGRAM, "state")));
    return runs ? String(this.store.fact(PROGRAM, "program") ?? "") : "";
  }

  /** End a program, wait until the tip is away, and let it follow the hand again; the answer says whether it does. */
  async followHand(): Promise<boolean> {
    const mayArm = this.commands.mayArmLater();
    if (this.program && !(await this.commands.command("abort", "set", INSTRUMENT, { program: "abort" }))) return false;
    const isEnding = (): boolean => this.program !== "" || this.store.fact("afm/state/slave", "mode") === "retracting";
    for (let waited = 0; isEnding() && waited < LONGEST_END_MS; waited += LOOK_MS) await new Promise((go) => setTimeout(go, LOOK_MS));
    return mayArm() && this.commands.arm();
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
      await this.commands.command(`move the tip to ${fixed(x, 2)}, ${fixed(y, 2)} nm`, "set", INSTRUMENT, place(x, y));
    }
    this.isSending = false;
  }
}

/** Parameters of a place [nm]. */
export function place(x: number, y: number): Values {
  return { "lateral.x_m": x * NM, "lateral.y_m": y * NM };
}
