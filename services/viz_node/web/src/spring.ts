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

/** The spring between what the page means and the newest arm that the server sent, however long the page draws. */
export class Spring {
  private meant: number | null = null;
  private heldUntil = -Infinity;
  private arm = NaN;
  private columns: Record<"position" | "x" | "y", number> = { position: -1, x: -1, y: -1 };
  private across: [number, number] | null = null;
  private place: [number, number] = [0, 0];
  private isHeld = false;

  /** Take note of where the arm is, if a frame says it. */
  take(frame: ServerFrame): void {
    if (frame.k === "snapshot") {
      const hand = frame.streams.find((stream) => stream.name === "hand");
      for (const name of ["position", "x", "y"] as const) this.columns[name] = hand?.columns.findIndex((column) => column.name === name) ?? -1;
      this.arm = NaN;
      this.place = [0, 0];
    } else if (frame.k === "tick") {
      const hand = frame.streams?.["hand"];
      if (!hand?.n || this.columns.position < 0) return;
      const values = floats(hand.data);
      // columns lie one after the other, behind that of the times
      const newest = (column: number, otherwise: number): number => {
        const value = column < 0 ? undefined : values[(column + 2) * hand.n - 1];
        return value === undefined || Number.isNaN(value) ? otherwise : value;
      };
      this.arm = newest(this.columns.position, this.arm);
      this.place = [newest(this.columns.x, this.place[0]), newest(this.columns.y, this.place[1])];
    }
  }

  /** Take note of where the page means the hand to be, down and across [m], null when it lets go, and whether it is kept there. */
  mean(meant_m: number | null, isKept: boolean, now: number, across_m: [number, number] | null = null): void {
    this.meant = meant_m;
    this.across = across_m;
    this.heldUntil = now + (isKept ? KEPT_DEADLINE_MS : PAGE_DEADLINE_MS);
  }

  /** Return the force to send now [N], null once when the hand lets go, undefined when there is nothing to send. */
  next(now: number): number | null | undefined {
    const isMeant = this.meant !== null || this.across !== null;
    const isHeld = isMeant && now < this.heldUntil && !Number.isNaN(this.arm);
    const hasLetGo = this.isHeld && !isHeld;
    this.isHeld = isHeld;
    return isHeld ? (this.meant === null ? 0 : springForce(this.meant, this.arm)) : hasLetGo ? null : undefined;
  }

  /** The force across the sample to send now, x and y [N]. */
  get acrossForce(): [number, number] {
    if (!this.isHeld || !this.across) return [0, 0];
    return [springForce(this.across[0], this.place[0]), springForce(this.across[1], this.place[1])];
  }
}
