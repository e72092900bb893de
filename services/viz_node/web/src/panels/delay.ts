import "../../gallery/gallery.css";
import { Gallery, type GalleryData } from "../../gallery/gallery.js";
import address from "../../gallery/gallery.json?url";
import { otherDelay } from "../link";
import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";

/** What a delay does to each law; it begins with the law and the round trip of the rig. */
export class DelayPanel implements Panel {
  private gallery: Gallery | undefined;
  private longest = 0;
  private readonly note = make("p", { class: "warning", id: "delay-in-force", role: "status" });
  private asked = false;

  constructor(
    private readonly root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {}

  write(): void {
    this.compare();
    if (this.asked) return;
    // the data are loaded when somebody looks at them
    this.asked = true;
    const place = make("div");
    this.root.replaceChildren(this.note, place);
    void fetch(address)
      .then((answer) => answer.json() as Promise<GalleryData>)
      .then((data) => {
        this.gallery = new Gallery(place, data);
        this.longest = data.delays_ms.at(-1)!;
        this.gallery.choose(String(this.cockpit.store.fact("law/status/master", "law") ?? ""), this.age);
        this.compare();
      })
      .catch((error: unknown) => {
        this.asked = false;
        place.textContent = `The gallery could not be loaded: ${String(error)}`;
      });
  }

  /** The round trip of the rig's loop now [ms]. */
  private get age(): number {
    return 1e3 * this.cockpit.store.last("hand", "loop_age");
  }

  /** Say where the delay of the pictures is not the one in force. */
  private compare(): void {
    const words = this.gallery ? otherDelay(this.age, this.gallery.delayMs, this.longest) : "";
    if (this.note.textContent !== words) this.note.textContent = words;
    this.note.hidden = !words;
  }
}
