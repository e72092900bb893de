import type { Connection } from "./connection";
import { creepText } from "./creep";
import { colour, make } from "./dom";
import { LOWER_M } from "./next";
import { Pressing } from "./pressing";
import type { HandNotice } from "./protocol";
import { LIMIT_N, springForce } from "./spring";
import { programName } from "./programs";
import type { Store } from "./store";
import { fixed, forceText } from "./numbers";

/** Height of the pad in the travel of the arm [m]. */
const TRAVEL_M = 0.025;
const TOP_M = -0.005;
/** How often the page says that it still means what it sent: the spring lets go without it. */
const SAY_MS = 50;
/** The force of the tip at which a gamepad rumbles with all it has, and from which it does [N]. */
const RUMBLE_N = 3;
const LEAST_FELT_N = 0.03;
/** Each effect lasts a little longer than the time to the next, so that a force that stands is felt without gaps. */
const RUMBLE_MS = 100;
const RUMBLE_EVERY_MS = 90;
/** A stick pushed to its end means to be this far [m]. */
const STICK_M = 0.015;
/** The hand goes so far across the sample, either way [m]. */
export const ACROSS_M = 0.02;
/** What a key moves it by [m]. */
const KEY_ACROSS_M = 2e-3;
const DEAD = 0.12;
/** Above and below the bars of the forces, and how wide each is with the room beside it [px]. */
const GAUGE_PX = 18;
const GAUGE_BAR_PX = 10;
/** Radius of the ring at the place that the person means [px]. */
const MEANT_PX = 8;
/** A hand is lifted by this much more than it has to be [m]. */
const LIFT_MORE_M = 0.5e-3;
/** Over this time it is looked whether a free hand moves [s], so often [ms]. */
const CREEP_S = 4;
const CREEP_LOOK_MS = 500;

/** How strongly a gamepad rumbles for a force that comes back [N]: from 0 to 1, and not for what a hand would not feel. */
export function rumbleStrength(back_n: number): number {
  const size = Math.abs(back_n);
  return size < LEAST_FELT_N ? 0 : Math.min(1, size / RUMBLE_N);
}

/** Why a hand that is held has to let go, by the mode of the instrument, its program, and whether a session runs. */
export function whyLetGo(mode: unknown, program: string, runs: boolean): string {
  if (program) return `the program ${programName(program)} runs`;
  if (!runs) return "the session has ended";
  return mode === "follow" || mode === "hold" ? "" : "the tip was withdrawn";
}

/** That the hand of a page is too late to count, and how late [s], with the way there and back [s]; empty for 0. */
export function slowText(late_s: number, way_s: number): string {
  if (!(late_s > 0)) return "";
  const age = late_s + (Number.isFinite(way_s) ? way_s / 2 : 0);
  return `Too slow: this page is ${fixed(1e3 * age, 0)} ms behind, and its force fades`;
}

/** A hand for those who have no device: drag down to push, and see the arm lag behind the pointer. */
export class Hand {
  private readonly canvas = make("canvas", { "aria-hidden": "true" });
  readonly pad = make("div", {
    class: "pad",
    id: "hand-pad",
    tabindex: 0,
    role: "slider",
    "aria-label": "Virtual hand: drag down, or hold the arrow keys, to push towards the sample",
    "aria-orientation": "vertical",
    "aria-valuemin": -LIMIT_N,
    "aria-valuemax": LIMIT_N,
    "aria-valuenow": 0,
  });
  readonly text = make("div", { class: "quiet", id: "hand-text", role: "status" });
  /** While it is pressed the hand stays where it is when the pointer or the key is let go, which then are free. */
  readonly keepButton = make("button", { type: "button", id: "hand-keep", "aria-pressed": "false", title: "The hand stays where it is, and the pointer is free for the other controls", onclick: () => this.toggleKeep() }, "Keep holding");
  /** Whether this page commands anything now. */
  may: () => boolean = () => false;
  private meant: number | undefined;
  private across: [number, number] | undefined;
  /** With the height of the pad, which may change while it is held: what is shown beside it must not move the hand. */
  private grabbedAt = { y: 0, arm: 0, height: 1 };
  private refusal = "";
  /** How late the server finds this hand [s]; 0 where it counts. */
  private lateS = 0;
  private readonly pressing = new Pressing();
  private rumbledAt = 0;
  private followed = false;

  constructor(
    private readonly connection: Connection,
    private readonly store: Store,
  ) {
    this.pad.append(this.canvas);
    this.pad.addEventListener("pointerdown", (event) => {
      if (!this.isOffered) return;
      this.pad.setPointerCapture(event.pointerId);
      this.grabbedAt = { y: event.clientY, arm: this.arm, height: this.pad.clientHeight };
      this.hold(this.arm);
    });
    this.pad.addEventListener("pointermove", (event) => {
      if (this.meant === undefined || !this.pad.hasPointerCapture(event.pointerId)) return;
      this.hold(this.grabbedAt.arm + ((event.clientY - this.grabbedAt.y) / this.grabbedAt.height) * TRAVEL_M);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) this.pad.addEventListener(name, () => this.release());
    this.pad.addEventListener("keydown", (event) => {
      const step = { ArrowDown: 1e-3, ArrowUp: -1e-3 }[event.key];
      if (step === undefined || !this.isOffered) return;
      event.preventDefault();
      this.hold((this.meant ?? this.arm) + step);
    });
    this.pad.addEventListener("keyup", (event) => {
      if (event.key === "ArrowDown" || event.key === "ArrowUp") this.release();
    });
    this.pad.addEventListener("blur", () => this.release());
    // who does not see the page must not push
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    // a timer and not the frames: a page in the background draws none, and its hand has to be let go in any case
    setInterval(() => this.say(), SAY_MS);
  }

  /** Whether this page may hold the hand. */
  get isOffered(): boolean {
    return this.store.hand && this.may();
  }

  /** Show whether the pad can be pressed, or only shows where the hand is. */
  begin(): void {
    this.pad.tabIndex = this.isOffered ? 0 : -1;
    this.pad.setAttribute("aria-disabled", String(!this.isOffered));
  }

  /** Whether it holds the hand now. */
  get isHeld(): boolean {
    return this.meant !== undefined || this.across !== undefined;
  }

  /** Where the hand means to be across the sample [m]; undefined where it does not. */
  get meantAcross(): [number, number] | undefined {
    return this.across;
  }

  /** Mean the hand to be at a place across the sample [m]; null to let go of that. */
  steer(place: [number, number] | null): void {
    if (place === null) {
      if (!this.across) return;
      this.across = undefined;
      if (this.meant === undefined) this.connection.mean(null);
      else this.say();
    } else if (this.isOffered) {
      this.refusal = "";
      this.across = place.map((value) => Math.max(-ACROSS_M, Math.min(ACROSS_M, value))) as [number, number];
      this.say();
    }
  }

  /** Take hold of the hand where it is, and keep it there without a pointer or a key, for somebody who presses a button. */
  holdHere(): void {
    if (!this.isOffered) return;
    if (this.meant === undefined) this.hold(this.arm);
    this.keepButton.setAttribute("aria-pressed", "true");
    this.say();
  }

  /** Mean a hand that is held to be lower than it is by so much, and lower than it was meant to be [m]. */
  lower(by_m: number): void {
    if (this.meant !== undefined) this.hold(Math.max(this.meant + LOWER_M, this.arm + by_m));
  }

  /** Lift the hand by so much and a little more, and hold it there [m]: the tip then meets it in the free. */
  lift(by_m: number): void {
    const up = this.arm - by_m - LIFT_MORE_M;
    this.holdHere();
    if (this.meant !== undefined) this.hold(Math.max(up, (this.store.travel_m?.[0] ?? TOP_M) + LIFT_MORE_M));
  }

  /** Why a hand that nobody holds moves all the same, in words; empty where it does not. */
  get creep(): string {
    const ring = this.store.rings.get("hand");
    const column = this.store.column("hand", "position");
    if (this.isHeld || !ring?.length || column < 0) return "";
    const first = ring.indexAt(ring.newest - CREEP_S);
    const moved = ring.value(column, ring.length - 1) - ring.value(column, first);
    return creepText(moved, ring.newest - ring.time(first), this.store.last("hand", "force"), this.store.last("command", "tip_force"));
  }

  /** Steer by an arrow key; whether the key was one. */
  steerByKey(key: string): boolean {
    const step = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
    if (!step) return false;
    const [x, y] = this.across ?? [0, 0];
    this.steer([x + step[0]! * KEY_ACROSS_M, y + step[1]! * KEY_ACROSS_M]);
    return true;
  }

  /** The force that the page means to push with now [N]; 0 where it holds nothing. */
  get force(): number {
    return this.meant === undefined ? 0 : springForce(this.meant, this.arm);
  }

  /** Take hold, or move, by a controller in VR: how far it went down, and across [m]; null to let go. */
  press(down: number | null, across: [number, number] = [0, 0]): void {
    if (down === null) {
      this.letGo();
      return;
    }
    this.drag(down * 0.1, true);
    this.steer([across[0] * 0.1, across[1] * 0.1]);
  }

  /** Take hold, or move, by the pointer in the scene: how far it went down, in its heights; null when it is let go. */
  pull(down: number | null): void {
    if (down === null) {
      this.isGrabbed = false;
      this.release();
    } else {
      // what was let go meanwhile, as by an emergency stop, is not taken up again by the same drag
      if (this.isGrabbed && this.meant === undefined) return;
      this.drag(down * TRAVEL_M, this.isGrabbed);
      this.isGrabbed = true;
    }
  }

  private isGrabbed = false;

  private drag(down_m: number, isGrabbed: boolean): void {
    if (this.meant === undefined || !isGrabbed) this.grabbedAt = { y: 0, arm: this.arm, height: 1 };
    this.hold(this.grabbedAt.arm + down_m);
  }

  /** Take what the server says of the hand: why it was let go, or how late this page is. */
  notice(frame: HandNotice): void {
    if (frame.late_s === undefined) this.refuse(frame.text);
    else this.lateS = frame.late_s;
  }

  refuse(text: string): void {
    this.refusal = text;
    this.letGo();
  }

  /**
   * Let go where the tip ceases to follow the hand: a program begins, the guard or somebody has it withdraw, the
   * operator's programme ends. A force that was held until then would press at once when the tip follows again.
   */
  followTip(mode: unknown, program: string, runs: boolean): void {
    const reason = whyLetGo(mode, program, runs);
    // what was said of a program, or of a tip that was withdrawn, is over with it
    if (!this.followed && !reason && this.refusal.startsWith("Let go: ")) this.refusal = "";
    if (this.followed && reason && this.isHeld) this.refuse(`Let go: ${reason}`);
    this.followed = !reason;
  }

  /** Compare the force that this page means with that of the hand, and say in the state of the rig where they are apart. */
  compare(): void {
    const { store } = this;
    const meant = this.meant === undefined ? undefined : this.force;
    // by the clock of what came: of a silent line, or a page that stood still, nothing is said of the hand
    store.apart = this.pressing.look(1e3 * store.freshness.sentAt, meant, store.last("hand", "force"), store.rings.get("hand")?.newest ?? NaN, store.wayS);
  }

  draw(): void {
    if (this.isOffered) this.readGamepad();
    if (!this.pad.clientHeight) return;
    const { clientWidth: width, clientHeight: height } = this.pad;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const pen = this.canvas.getContext("2d")!;
    const toY = (m: number): number => ((m - TOP_M) / TRAVEL_M) * height;
    pen.clearRect(0, 0, width, height);
    pen.font = "12px system-ui";
    for (let mm = 0; mm <= 20; mm += height < 130 ? 10 : 5) {
      pen.fillStyle = colour("line");
      pen.fillRect(0, toY(mm / 1e3), width, 1);
      pen.fillStyle = colour("quiet");
      // the lowest label stands above its line, where the pad ends
      pen.fillText(`${mm} mm`, 4, toY(mm / 1e3) - 3);
    }
    const { travel_m } = this.store;
    if (travel_m) {
      // where the guard lets no hand go
      pen.fillStyle = colour("line");
      pen.globalAlpha = 0.6;
      pen.fillRect(0, 0, width, Math.max(0, toY(travel_m[0])));
      pen.fillRect(0, toY(travel_m[1]), width, height);
      pen.globalAlpha = 1;
    }
    const x = width * 0.5;
    const arm = toY(this.arm);
    const force = this.meant === undefined ? 0 : springForce(this.meant, this.arm);
    if (this.meant !== undefined) {
      pen.strokeStyle = colour("hand");
      pen.lineWidth = 1 + 3 * Math.abs(force / LIMIT_N);
      pen.setLineDash([4, 3]);
      pen.beginPath();
      pen.moveTo(x, arm);
      pen.lineTo(x, toY(this.meant));
      pen.stroke();
      pen.setLineDash([]);
      // whole also where it is at an end of the pad
      disc(pen, x, Math.min(Math.max(toY(this.meant), MEANT_PX + 1), height - MEANT_PX - 1), MEANT_PX, colour("hand"), false);
    }
    disc(pen, x, arm, 12, colour("hand"), true);
    const back = this.store.last("command", "tip_force");
    this.drawForces(pen, width, height, this.store.last("hand", "force"), back);
    const isFar = this.meant !== undefined && this.meant >= TOP_M + TRAVEL_M;
    const isOld = this.store.isPictureOld || this.store.isOld("hand");
    const own = this.meant === undefined ? this.freeText() : isFar ? "Held at the end of the travel: the force grows no more" : "Held: release to let go, or press Keep holding";
    const slow = this.meant === undefined ? "" : slowText(this.lateS, this.store.wayS);
    const apart = this.meant === undefined || !this.store.apart ? "" : `Force differs: ${this.store.apart}`;
    const mark = slow ? "too slow" : apart ? "force differs" : "";
    if (mark) {
      pen.fillStyle = colour("bad");
      pen.fillText(mark, x - pen.measureText(mark).width / 2, 16);
    }
    this.pad.dataset["slow"] = String(slow !== "");
    this.pad.dataset["apart"] = String(apart !== "");
    const text = isOld ? "" : this.refusal || slow || apart || own;
    if (this.text.textContent !== text) this.text.textContent = text;
    this.pad.dataset["held"] = String(this.meant !== undefined);
    this.pad.setAttribute("aria-valuenow", fixed(force, 2));
    this.pad.setAttribute("aria-valuetext", `${forceText(force)} N, ${forceText(back)} N felt from the tip`);
    this.rumble(back);
  }

  /** Both forces beside each other up to the limit of the hand: what presses down, and what comes back up. */
  private drawForces(pen: CanvasRenderingContext2D, width: number, height: number, own_n: number, back_n: number): void {
    const room = height - 2 * GAUGE_PX;
    const left = width - 2 * GAUGE_BAR_PX - GAUGE_PX;
    const bar = (at: number, value: number, name: string): void => {
      pen.fillStyle = colour("line");
      pen.fillRect(at, GAUGE_PX, GAUGE_BAR_PX - 2, room);
      const size = Math.min(1, Math.abs(value) / LIMIT_N) * room;
      pen.fillStyle = colour(name);
      if (size >= 1) pen.fillRect(at, GAUGE_PX + room - size, GAUGE_BAR_PX - 2, size);
    };
    bar(left, Number.isNaN(own_n) ? 0 : own_n, "hand");
    bar(left + GAUGE_BAR_PX, Number.isNaN(back_n) ? 0 : back_n, "tip");
    pen.fillStyle = colour("text");
    pen.fillRect(left - 3, GAUGE_PX - 1, 2 * GAUGE_BAR_PX + 4, 2);
    pen.fillStyle = colour("quiet");
    pen.textAlign = "right";
    pen.fillText(`${LIMIT_N} N`, width - 4, GAUGE_PX - 5);
    pen.textAlign = "left";
  }

  private freeText(): string {
    const now = performance.now();
    if (now - this.creepAt > CREEP_LOOK_MS) [this.creepAt, this.creepShown] = [now, this.creep];
    return this.creepShown || (!this.isOffered ? "" : this.followed ? "Drag down, here or in the scene" : "The tip does not follow the hand now");
  }

  private creepAt = -Infinity;
  private creepShown = "";

  private get arm(): number {
    const found = this.store.last("hand", "position");
    return Number.isNaN(found) ? 0 : found;
  }

  private hold(meant_m: number): void {
    this.refusal = "";
    this.meant = Math.max(TOP_M, Math.min(TOP_M + TRAVEL_M, meant_m));
    this.say();
  }

  private get isKept(): boolean {
    return this.keepButton.getAttribute("aria-pressed") === "true";
  }

  private toggleKeep(): void {
    this.keepButton.setAttribute("aria-pressed", String(!this.isKept));
    if (this.isKept) this.say();
    else this.letGo();
  }

  private release(): void {
    if (!this.isKept) this.letGo();
  }

  /** Let go, also of a hand that is kept: after an emergency stop, and when the page is no longer seen. */
  letGo(): void {
    this.keepButton.setAttribute("aria-pressed", "false");
    if (!this.isHeld) return;
    this.meant = this.across = undefined;
    for (const motor of motors()) void motor.reset().catch(() => undefined);
    this.connection.mean(null);
  }

  private say(): void {
    if (this.isHeld) this.connection.mean(this.meant ?? null, this.isKept, this.across ?? null);
  }

  private stick = false;
  private sideStick = false;

  private readGamepad(): void {
    const push = gamepads()[0]?.axes[1] ?? 0;
    if (Math.abs(push) > DEAD) {
      this.stick = true;
      this.hold(push * STICK_M);
    } else if (this.stick) {
      this.stick = false;
      this.release();
    }
    const [x, y] = [gamepads()[0]?.axes[2] ?? 0, -(gamepads()[0]?.axes[3] ?? 0)];
    if (Math.hypot(x, y) > DEAD) {
      this.sideStick = true;
      this.steer([x * STICK_M, y * STICK_M]);
    } else if (this.sideStick) {
      this.sideStick = false;
      this.steer(null);
    }
  }

  /** Let a gamepad rumble while the hand is held, whether by its stick, the pointer, the keys or a headset. */
  private rumble(back_n: number): void {
    const now = performance.now();
    if (this.meant === undefined || now - this.rumbledAt < RUMBLE_EVERY_MS) return;
    this.rumbledAt = now;
    const strength = rumbleStrength(back_n);
    const effect = { duration: RUMBLE_MS, strongMagnitude: strength, weakMagnitude: strength / 2 };
    for (const motor of motors()) void motor.playEffect("dual-rumble", effect).catch(() => undefined);
  }
}

function motors(): GamepadHapticActuator[] {
  return gamepads().flatMap((pad) => (pad.vibrationActuator ? [pad.vibrationActuator] : []));
}

function gamepads(): Gamepad[] {
  return [...(navigator.getGamepads?.() ?? [])].filter((pad): pad is Gamepad => pad?.connected === true);
}

function disc(pen: CanvasRenderingContext2D, x: number, y: number, radius: number, stroke: string, filled: boolean): void {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  pen.lineWidth = 2;
  pen.strokeStyle = pen.fillStyle = stroke;
  if (filled) pen.fill();
  else pen.stroke();
}
