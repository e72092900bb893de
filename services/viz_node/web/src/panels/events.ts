import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import type { EventFacts } from "../protocol";
import { eventText } from "../sentences";

const SHOWN = 80;

/** What the nodes reported, newest first, at times as ISO 8601 has them. */
export class EventsPanel implements Panel {
  private readonly list = make("ol", { tabindex: 0, "aria-label": "Events, newest first" });
  private shown = -1;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    root.append(this.list);
  }

  begin(): void {
    this.shown = -1;
  }

  write(): void {
    const { events } = this.cockpit.store;
    const newest = events.at(-1)?.t ?? 0;
    const key = events.length + newest;
    if (key === this.shown) return;
    this.shown = key;
    this.list.replaceChildren(
      ...events.filter((event) => !isVisit(event)).slice(-SHOWN).reverse().map((event) => {
        const at = new Date(event.t / 1e6);
        const time = make("time", { datetime: at.toISOString(), title: at.toISOString() }, clock(at));
        return make("li", { class: event.level, title: event.src }, time, eventText(event.src, event.text));
      }),
    );
  }
}

/** Whether an event tells only that a console has ended, which comes and goes with each command of a shell. */
export function isVisit({ kind, src }: Pick<EventFacts, "kind" | "src">): boolean {
  return kind === "node" && src.startsWith("console@");
}

/** Hours, minutes, seconds and tenths of the local day, in the order of ISO 8601. */
export function clock(at: Date): string {
  const two = (value: number): string => String(value).padStart(2, "0");
  return `${two(at.getHours())}:${two(at.getMinutes())}:${two(at.getSeconds())}.${Math.floor(at.getMilliseconds() / 100)}`;
}
