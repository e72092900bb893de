import { make, part } from "./dom";

/** What became of a request: the server answered, or nothing did, which leaves open whether it was carried out. */
export type Outcome = "acknowledged" | "refused" | "not sent" | "lost" | "no answer";

const SHOWN_MS = 7000;
const MOST_SHOWN = 3;
const GAP_PX = 6;
const CONTROLS = "button, select, input, textarea, summary, canvas, [role=slider]";
/** What no answer covers: the stop, and what arms after it. */
const KEPT_FREE = ["estop", "rearm", "arm"];
const LOOKS: Record<Outcome, string> = { acknowledged: "done", refused: "refused", "not sent": "refused", lost: "unknown", "no answer": "unknown" };

/** What came of an action, in one line: who said so, or that nobody did and for how long this page waited [s]. */
export function outcomeText(about: string, outcome: Outcome, text: string, waitedS = 0): string {
  const waited = waitedS < 10 ? waitedS.toFixed(1) : waitedS.toFixed(0);
  if (outcome === "lost") return `${about}: connection lost after ${waited} s, before the answer · it may have been carried out, or not`;
  if (outcome === "no answer") return `${about}: no answer in ${waited} s · it may have been carried out, or not: the rig or its server may be gone`;
  return `${about}: ${outcome} · ${text}`;
}

/** A part of the window [px]. */
export interface Box {
  left: number;
  top: number;
  right: number;
  bottom: number;
}

/** Where a note of a size is placed beside a control: below it, or above where there is no room, and over none of `free`. */
export function placeBeside(control: Box, size: { width: number; height: number }, view: { width: number; height: number }, free: readonly Box[]): { left: number; top: number } {
  const left = Math.max(GAP_PX, Math.min(control.left, view.width - size.width - GAP_PX));
  const covered = (top: number): Box | undefined =>
    [control, ...free].find((box) => box.left < left + size.width && left < box.right && box.top < top + size.height && top < box.bottom);
  // a control that was scrolled away has its answer at the edge where it went
  const [first, last] = [GAP_PX, view.height - GAP_PX - size.height];
  let below = Math.max(first, control.bottom + GAP_PX);
  for (let met = covered(below); met; met = covered(below)) below = met.bottom + GAP_PX;
  let above = Math.min(last, control.top - GAP_PX - size.height);
  for (let met = covered(above); met; met = covered(above)) above = met.top - GAP_PX - size.height;
  return { left, top: below <= last ? below : Math.max(first, above) };
}

/** The answers to what was done last, each beside the control that was used; they take no press and move nothing. */
export class Answers {
  private control: Element | undefined;
  private readonly notes = new Map<HTMLElement, { control: Element | undefined; at: Box }>();

  constructor() {
    // before the handlers of the control itself
    const remember = ({ target }: Event): void => {
      this.control = target instanceof Element ? (target.closest(CONTROLS) ?? undefined) : undefined;
    };
    for (const name of ["click", "change", "keydown", "pointerdown"]) addEventListener(name, remember, { capture: true });
    for (const name of ["scroll", "resize"]) addEventListener(name, () => this.place(), { capture: true, passive: true });
  }

  /** Name the control for an action by a key that is not its own, such as Escape. */
  use(id: string): void {
    this.control = part(id);
  }

  /** Show that an action has no answer yet. */
  pending(about: string): HTMLElement {
    const note = make("div", { class: "answer pending" }, `${about} …`);
    const { control } = this;
    for (const [other, known] of this.notes) {
      if (known.control === control && !other.classList.contains("pending")) this.remove(other);
    }
    // What is not answered yet stays.
    const answered = [...this.notes.keys()].filter((each) => !each.classList.contains("pending"));
    for (const each of answered.slice(0, Math.max(0, answered.length - MOST_SHOWN + 1))) this.remove(each);
    this.notes.set(note, { control, at: boxOf(control) });
    part("answers").prepend(note);
    this.place();
    return note;
  }

  settle(note: HTMLElement, outcome: Outcome, words: string): void {
    note.className = `answer ${LOOKS[outcome]}`;
    this.end(note, words);
  }

  /** Show words that answer nothing. */
  tell(words: string): void {
    const note = this.pending("");
    note.className = "answer said";
    this.end(note, words);
  }

  private end(note: HTMLElement, words: string): void {
    note.textContent = words;
    this.place();
    setTimeout(() => this.remove(note), SHOWN_MS);
  }

  private remove(note: HTMLElement): void {
    this.notes.delete(note);
    note.remove();
  }

  private place(): void {
    const free = KEPT_FREE.flatMap((id) => boxesOf(document.getElementById(id)));
    const view = { width: document.documentElement.clientWidth, height: innerHeight };
    const taken: Box[] = [];
    for (const [note, known] of this.notes) {
      // a button that was replaced by another, as those of the lease are, keeps its place
      known.at = boxesOf(known.control)[0] ?? known.at;
      const { width, height } = note.getBoundingClientRect();
      const { left, top } = placeBeside(known.at, { width, height }, view, [...free, ...taken]);
      note.style.left = `${left}px`;
      note.style.top = `${top}px`;
      taken.push({ left, top, right: left + width, bottom: top + height });
    }
  }
}

/** The part of the window that an element takes, if it is shown. */
function boxesOf(element: Element | null | undefined): Box[] {
  const box = element?.isConnected ? element.getBoundingClientRect() : undefined;
  return box && box.width > 0 ? [box] : [];
}

/** The same, or that of the state of the rig where no control is shown. */
function boxOf(element: Element | undefined): Box {
  return boxesOf(element)[0] ?? part("banners").getBoundingClientRect();
}
