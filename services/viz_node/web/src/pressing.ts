import { fixed } from "./numbers";

/** What the page meant is compared with what the hand does over this time and the way there and back [ms]. */
const WINDOW_MS = 1000;
/** For so much of that time they may be apart: what is in transit, and a drop that no hand feels [ms]. */
const APART_MS = 200;
/** Nothing new of the hand for this long: what is shown is past [ms]. */
const SILENT_MS = 400;
/** Shown for at least this long, so that it can be read [ms]. */
const SHOWN_MS = 2000;
/** A difference that is none: a smaller force [N], or a smaller share of it. */
const LEAST_N = 0.2;
const LEAST_SHARE = 0.25;

interface Look {
  at: number;
  meant: number;
  pressed: number;
  isApart: boolean;
}

/**
 * Whether the force that the hand presses with is the one that the page means. The haptic node presses with none where
 * it has heard nothing of the page for too long, and a server that was held up tells no page so.
 */
export class Pressing {
  private looks: Look[] = [];
  private shown: { text: string; until: number } | undefined;
  private newest = NaN;
  private newestAt = 0;

  /**
   * Take a look, and return in words how the two are apart; empty where they are not.
   *
   * `now`: when the server sent the newest of it [ms]; `meant`: force that the page means [N], undefined
   * where it holds nothing; `pressed`: force of the newest sample of the hand [N], and `newest`, the time of that [s];
   * `way_s`: way to the server and back [s], NaN where it is not known.
   */
  look(now: number, meant: number | undefined, pressed: number, newest: number, way_s: number): string {
    if (newest !== this.newest) [this.newest, this.newestAt] = [newest, now];
    if (meant === undefined) {
      this.looks = [];
      this.shown = undefined;
      return "";
    }
    // before it was taken hold of the page meant no force
    if (!this.looks.length) {
      this.looks.push({ at: now, meant: 0, pressed: 0, isApart: false });
      this.newestAt = now;
    }
    const window = WINDOW_MS + (Number.isFinite(way_s) ? 1e3 * way_s : 0);
    this.looks = this.looks.filter(({ at }) => now - at <= window);
    const all = [...this.looks.map((look) => look.meant), meant];
    const room = Math.max(LEAST_N, LEAST_SHARE * Math.abs(meant));
    const isSilent = now - this.newestAt > SILENT_MS;
    const isApart = !(pressed >= Math.min(...all) - room && pressed <= Math.max(...all) + room);
    this.looks.push({ at: now, meant, pressed, isApart });
    let apart = 0;
    this.looks.forEach((look, i) => (apart += look.isApart ? look.at - (this.looks[i - 1]?.at ?? look.at) : 0));
    if (isSilent || apart >= APART_MS) {
      // where they agree again for the moment, it is said how they did not
      const last = this.looks.findLast((look) => look.isApart) ?? { meant, pressed };
      const hand = isSilent || Number.isNaN(last.pressed) ? "no data came from the hand" : `the hand pressed with ${fixed(last.pressed, 1)} N`;
      this.shown = { text: `this page asked for ${fixed(last.meant, 1)} N, and ${hand}`, until: now + SHOWN_MS };
    } else if (this.shown && now > this.shown.until) this.shown = undefined;
    return this.shown?.text ?? "";
  }
}
