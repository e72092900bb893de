import { make, part } from "./dom";
import { plain } from "./sentences";
import { fixed } from "./numbers";

/** What became of a request: the server answered (not acknowledged: a node did not, and none refused), or nothing did, which leaves open whether it was carried out. */
export type Outcome = "acknowledged" | "not acknowledged" | "refused" | "not sent" | "lost" | "no answer";

/** An answer stands for so long, unless another one comes: it covers nothing. */
const SHOWN_MS = 12_000;
const MOST_SHOWN = 3;
const LOOKS: Record<Outcome, string> = { acknowledged: "done", "not acknowledged": "refused", refused: "refused", "not sent": "refused", lost: "unknown", "no answer": "unknown" };

/** What came of an action, in one line: who said so, or that nobody did and for how long this page waited [s]. */
export function outcomeText(about: string, outcome: Outcome, text: string, waitedS = 0): string {
  const waited = waitedS < 10 ? fixed(waitedS, 1) : fixed(waitedS, 0);
  if (outcome === "lost") return `${about}: connection lost after ${waited} s, before the answer · it may have been carried out, or not`;
  if (outcome === "no answer") return `${about}: no answer in ${waited} s · it may have been carried out, or not: the rig or its server may be gone`;
  if (outcome === "not acknowledged") return `${about}: not acknowledged by all that were asked · ${text}`;
  return `${about}: ${outcome} · ${text}`;
}

/** Note whether the newest answer has more lines than its place: it then opens under the pointer, or with the focus. */
function fit(): void {
  const place = part("answers");
  const isLong = (place.firstElementChild?.scrollHeight ?? 0) > place.parentElement!.clientHeight;
  place.toggleAttribute("data-long", isLong);
  if (isLong) place.tabIndex = 0;
  else place.removeAttribute("tabindex");
}

/** The answers to what was done last, newest first, in a place of their own where they cover and move nothing. */
export class Answers {
  /** Show that an action has no answer yet. */
  pending(about: string): HTMLElement {
    const note = make("div", { class: "answer pending" }, `${about} …`);
    const place = part("answers");
    place.prepend(note);
    // What is not answered yet stays.
    const answered = [...place.children].filter((each) => !each.classList.contains("pending"));
    for (const each of answered.slice(MOST_SHOWN - 1)) each.remove();
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
    note.textContent = note.title = plain(words);
    setTimeout(() => {
      note.remove();
      fit();
    }, SHOWN_MS);
    fit();
  }
}
