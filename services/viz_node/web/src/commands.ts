import { outcomeText, type Answers, type Outcome } from "./answers";
import type { Connection, LinkState } from "./connection";
import type { Values } from "./form";
import type { Facts } from "./protocol";
import type { Store } from "./store";
import { countdown } from "./countdown";
import { fixed } from "./numbers";

/** A slow base may take minutes until the tip is placed; the server itself gives up when it takes twice what the instrument says. */
const PLACED_MS = 600_000;
/** Hand and tip: the server arms both, and answers when the tip is placed. */
const DEVICES = "*";
/** After the last press of the stop, and after it is first shown, *Arm* cannot be pressed: a second tap never arms [ms]. */
const REARM_MS = 1500;
/** Among so many of the newest events is the one by which a node refused what this page asked for. */
const REPORTED = 8;
/** What ends a tip's way back. */
const INPUTS = ["keydown", "pointerdown", "wheel"] as const;

/** Commands of the operator; each shows what became of it. */
export class Commands {
  private stops = 0;
  /** What goes back at a word of this page: when it began [ms], how long it takes [s], and its words. */
  private way: { begun: number; length_s: number; text: string } | undefined;
  /** The place of which the person has said that the tip stays away from it [m]. */
  private stayed: number | undefined;
  /** When the rig was stopped, as this page saw it, or when its stop was pressed last [ms]. */
  private stoppedAt = -Infinity;
  private wasStopped = false;
  /** Called when an emergency stop is asked for, before it is answered. */
  onEstop: () => void = () => {};
  /** Called before devices are armed: the tip must not press at once with a force that was held before. */
  onArm: () => void = () => {};
  link: LinkState = "connecting";
  /** Why there is no connection, in words. */
  linkText = "";

  constructor(
    private readonly connection: Connection,
    private readonly store: Store,
    private readonly answers: Pick<Answers, "pending" | "settle" | "tell">,
  ) {}

  /** Whether this page commands anything: it is connected, to a rig, and its person may have the hand. */
  get may(): boolean {
    return this.link === "open" && this.store.role !== "observer" && this.store.commands;
  }

  /** Why the emergency stop of this page stops nothing, and what does; empty where it stops. */
  get deadStop(): { short: string; long: string; isSent: boolean } | undefined {
    if (this.link !== "open") {
      return { short: "STOP NOT CONNECTED", long: "This page is not connected and stops nothing: use the switch of the instrument, or type: telenano estop", isSent: false };
    }
    if (this.store.isPictureOld) {
      // it is sent all the same: the line may carry it although nothing comes back
      return { short: "STOP NOT CONNECTED", long: "This page hears nothing, and its stop may reach nothing: use the switch of the instrument, or type: telenano estop", isSent: true };
    }
    if (this.store.source.kind === "recording") return { short: "NOTHING TO STOP", long: "This is a recording: it moves nothing", isSent: false };
    return undefined;
  }

  async estop(): Promise<void> {
    const dead = this.deadStop;
    this.stops++;
    this.stoppedAt = performance.now();
    this.onEstop();
    if (dead && !dead.isSent) this.settle(this.answers.pending("emergency stop"), "emergency stop", "not sent", dead.long);
    else await this.ask("emergency stop", { k: "estop" });
  }

  async command(about: string, command: string, target: string, parameters: Values = {}): Promise<boolean> {
    return this.ask(about, { k: "command", command, target, parameters, lease: this.store.ownLease });
  }

  /** Whether *Arm* may be pressed at a time [ms]: not right after a press of the stop, nor after a stop is first seen. */
  mayArm(now: number): boolean {
    const isStopped = this.may && this.isStopped;
    if (isStopped && !this.wasStopped) this.stoppedAt = now;
    this.wasStopped = isStopped;
    return this.may && now - this.stoppedAt >= REARM_MS;
  }

  /** Whether a device is in emergency stop, as far as the page knows. */
  get isStopped(): boolean {
    return this.store.fact("afm/state/slave", "mode") === "estop" || this.store.fact("haptic/state/master", "estop") === true;
  }

  /** Arm hand and tip in one request: both stay where they are. The answer says whether both are armed. */
  async arm(): Promise<boolean> {
    this.onArm();
    this.stayed = undefined;
    const fields = { k: "command", command: "arm", target: DEVICES, parameters: {}, lease: this.store.ownLease };
    return this.ask("arm hand and tip", fields, PLACED_MS);
  }

  /** Where an armed tip would go back to, in words with place, speed and time; undefined where it has no way back. */
  get wayBack(): { text: string; place_m: number; speed_m_per_s: number; time_s: number } | undefined {
    const [place, speed, time] = ["return_place_m", "return_speed_m_per_s", "return_s"].map((key) => this.store.fact("afm/state/slave", key));
    if (typeof place !== "number" || typeof speed !== "number" || typeof time !== "number") return undefined;
    // the base lies towards the sample > 0
    const nm = fixed(place * 1e9, 1);
    return { text: `Go back to ${nm} nm (${fixed(speed * 1e9, 0)} nm/s, ${fixed(time, 1)} s)`, place_m: place, speed_m_per_s: speed, time_s: time };
  }

  /** Leave the tip where it is: its way back is no longer offered first, until there is another one. */
  stay(): void {
    this.stayed = this.wayBack?.place_m;
  }

  /** Whether the person has chosen that the tip stays, of the way back that there is now. */
  get stays(): boolean {
    return this.stayed !== undefined && this.stayed === this.wayBack?.place_m;
  }

  /** How far the tip is on its way back at a time [ms]; undefined where it does not go. */
  goingAt(now: number): { text: string; share: number } | undefined {
    if (!this.way) return undefined;
    const { text, share } = countdown(this.way.begun, this.way.length_s, now);
    return { text: `${this.way.text.replace("Go", "The tip goes")}: ${text}`, share };
  }

  /** Let the tip go back, as its button says; any key and any press of the pointer ends it, and the tip stays where it is. */
  async goBack(): Promise<boolean> {
    const way = this.wayBack;
    if (!way || this.way) return false;
    this.onArm();
    this.stayed = undefined;
    const { place_m, speed_m_per_s } = way;
    this.way = { begun: performance.now(), length_s: way.time_s, text: way.text };
    const fields = { k: "command", command: "arm", target: DEVICES, parameters: { place_m, speed_m_per_s }, lease: this.store.ownLease };
    // The server gives the way up for whatever command comes after it; arming starts nothing. The stop needs no more.
    const end = (event: Event): void => {
      if ((event as KeyboardEvent).key !== "Escape" && this.way) void this.arm();
      this.way = undefined;
    };
    for (const name of INPUTS) addEventListener(name, end, { capture: true });
    try {
      return await this.ask(way.text.replace("Go", "go"), fields, PLACED_MS);
    } finally {
      this.way = undefined;
      for (const name of INPUTS) removeEventListener(name, end, { capture: true });
    }
  }

  /** Return whether hand and tip may be armed at the end of something that begins now: not after a stop that comes meanwhile. */
  mayArmLater(): () => boolean {
    const { stops, isStopped } = this;
    return () => stops === this.stops && (isStopped || !this.isStopped);
  }

  /** Couple hand and tip anew: the tip is withdrawn, and armed when the hand is at rest. */
  async couple(): Promise<boolean> {
    this.onArm();
    return this.command("couple hand and tip", "couple", "*");
  }

  async ask(about: string, fields: Facts, patienceMs?: number): Promise<boolean> {
    const note = this.answers.pending(about);
    const answer = await this.connection.ask(fields, patienceMs);
    this.store.takeLease(answer.lease);
    this.settle(note, about, answer.outcome, answer.text, answer.waited_s);
    return answer.ok;
  }

  /** Show the answer to what needs no server. */
  show(about: string, ok: boolean, text: string): void {
    this.settle(this.answers.pending(about), about, ok ? "acknowledged" : "refused", text);
  }

  /** Say something that is neither an acknowledgement nor a refusal. */
  tell(text: string): void {
    this.answers.tell(text);
  }

  /** Show what became of an action; what no node reports, because it did not reach one, is kept in the list of events. */
  private settle(note: HTMLElement, about: string, outcome: Outcome, text: string, waitedS = 0): void {
    const words = outcomeText(about, outcome, text, waitedS);
    this.answers.settle(note, outcome, words);
    const isReported = outcome === "acknowledged" || this.store.events.slice(-REPORTED).some((event) => event.text !== "" && text.includes(event.text));
    if (!isReported) this.store.note("warning", words);
  }
}
