/** By device, whether it is latched in emergency stop as far as the page knows. */
type Latched = () => Record<string, boolean>;

/** Ends what takes several commands, such as arming both devices, when an emergency stop comes between them. */
export class Stops {
  private count = 0;

  constructor(private readonly latched: Latched) {}

  /** Count an emergency stop of this page. */
  note(): void {
    this.count++;
  }

  /** Begin something; the answer says whether it may go on: no stop since then, from this page or from elsewhere. */
  begin(): () => boolean {
    const { count } = this;
    const before = this.latched();
    return () => count === this.count && Object.entries(this.latched()).every(([device, is]) => !is || before[device] === true);
  }
}
