import "../../gallery/gallery.css";
import { Gallery, type GalleryData } from "../../gallery/gallery.js";
import address from "../../gallery/gallery.json?url";
import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";

/** What a delay does to each law; it begins with the law and the round trip of the rig. */
export class DelayPanel implements Panel {
  private gallery: Gallery | undefined;
  private asked = false;

  constructor(
    private readonly root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {}

  write(): void {
    if (this.asked) return;
    // the data are loaded when somebody looks at them
    this.asked = true;
    const place = make("div");
    this.root.replaceChildren(place);
    void fetch(address)
      .then((answer) => answer.json() as Promise<GalleryData>)
      .then((data) => {
        this.gallery = new Gallery(place, data);
        const { store } = this.cockpit;
        this.gallery.choose(String(store.fact("law/status/master", "law") ?? ""), 1e3 * store.last("hand", "loop_age"));
      })
      .catch((error: unknown) => {
        this.asked = false;
        place.textContent = `The gallery could not be loaded: ${String(error)}`;
      });
  }
}
