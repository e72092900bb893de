/** Part of the greatest force so far, and the force in N, by which a press has to rise and to fall: less is a tremor. */
const LEAST_SHARE = 0.1;
const LEAST_N = 0.1;

/** How often the hand has pressed harder and then less again: `analysis/hand_cycles.py` counts a recording so. */
export class CycleCounter {
  count = 0;
  private rises = false;
  private turn = NaN;
  private greatest = 0;

  see(force: number): void {
    if (Number.isNaN(force)) return;
    this.greatest = Math.max(this.greatest, Math.abs(force));
    if (Number.isNaN(this.turn)) this.turn = force;
    this.turn = this.rises ? Math.max(this.turn, force) : Math.min(this.turn, force);
    if (Math.abs(force - this.turn) <= Math.max(LEAST_N, LEAST_SHARE * this.greatest)) return;
    if (this.rises) this.count += 1;
    this.rises = !this.rises;
    this.turn = force;
  }
}
