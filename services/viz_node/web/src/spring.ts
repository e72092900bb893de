import { floats, type ServerFrame } from "./protocol";

/** The spring between the pointer and the arm: an operator of 200 N/m, softer than a real arm, for the page is late. */
export const STIFFNESS_N_PER_M = 200;
export const LIMIT_N = 5;
/** Nothing heard of the page for this long: it has let go [ms]. Most pictures take less, also without a graphics processor. */
export const PAGE_DEADLINE_MS = 1000;
/** The same for a hand that is kept without pointer or key: there is none that could be let go meanwhile. */
export const KEPT_DEADLINE_MS = 5000;

/** The force of a hand that means to be at one place while the arm is at another [N], towards the sample. */
export function springForce(meant_m: number, arm_m: number): number {
  const force = STIFFNESS_N_PER_M * (meant_m - arm_m);
  return Math.max(-LIMIT_N, Math.min(LIMIT_N, force));
}

/** The spring between what the page means and the newest arm that the server told, however long the page draws. */
export class Spring {
  private meant: number | null = null;
  private heldUntil = -Infinity;
  private arm = NaN;
  private column = -1;
  private isHeld = false;

  /** Take note of where the arm is, if a frame says it. */
  take(frame: ServerFrame): void {
    if (frame.k === "snapshot") {
      const hand = frame.streams.find((stream) => stream.name === "hand");
      this.column = hand?.columns.findIndex((column) => column.name === "position") ?? -1;
      this.arm = NaN;
    } else if (frame.k === "tick") {
      const hand = frame.streams?.["hand"];
      if (!hand?.n || this.column < 0) return;
      // columns lie one after the other, behind that of the times
      const arm = floats(hand.data)[(this.column + 2) * hand.n - 1];
      if (arm !== undefined && !Number.isNaN(arm)) this.arm = arm;
    }
  }

  /** Take note of where the page means the hand to be [m], null when it lets go, and whether it is kept there. */
  mean(meant_m: number | null, isKept: boolean, now: number): void {
    this.meant = meant_m;
    this.heldUntil = now + (isKept ? KEPT_DEADLINE_MS : PAGE_DEADLINE_MS);
  }

  /** Return the force to send now [N], null once when the hand lets go, undefined when there is nothing to send. */
  next(now: number): number | null | undefined {
    const isHeld = this.meant !== null && now < this.heldUntil && !Number.isNaN(this.arm);
    const hasLetGo = this.isHeld && !isHeld;
    this.isHeld = isHeld;
    return isHeld ? springForce(this.meant!, this.arm) : hasLetGo ? null : undefined;
  }
}
