import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { View } from "../scene";
import { forceText } from "../numbers";

/** Tip and surface, in three dimensions and from above: the scene is the control of the tip. */
export class ScenePanel implements Panel {
  view: View | undefined;
  private isStale = false;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const { store, tip, hand, commands, image } = cockpit;
    try {
      const view = new View(root, store, image.surface);
      view.onPlace = (x, y) => tip.moveTo(x, y);
      view.onPress = (down) => hand.pull(down);
      view.pressText = () => `${forceText(hand.force)} N, felt ${forceText(store.last("command", "tip_force"))} N`;
      view.headset.onPress = (down, across) => hand.press(down, across);
      view.headset.onGrab = (x, y) => image.onGrab(x, y);
      view.headset.onStop = () => void commands.estop();
      view.headset.onNext = () => image.onNext();
      view.nextText = () => image.nextText();
      store.onLines = (lines) => {
        view.addLines(lines);
        this.isStale = true;
      };
      store.onRestart = () => view.clear();
      image.onLook = () => view.look();
      image.onPicture = () => (image.surface.isEmpty ? undefined : view.flat.export());
      view.flat.overlay = (pen, at, scale) => image.onDraw(pen, at, scale);
      view.flat.grab = (x, y) => image.onGrab(x, y);
      image.redraw = () => {
        view.flat.redraw();
        this.isStale = true;
      };
      this.view = view;
    } catch (error) {
      root.append(make("p", { class: "error" }, `No picture in three dimensions: ${String(error)}. Everything else works.`));
      store.onLines = (lines) => lines.forEach((line) => image.surface.add(line));
      store.onRestart = () => image.surface.clear();
    }
  }

  begin(): void {
    const { hand, tip, commands } = this.cockpit;
    this.view?.offer(hand.isOffered, tip.isThere && commands.may);
  }

  frame(): void {
    this.view?.flat.draw();
  }

  write(): void {
    this.view?.writeTag();
    this.view?.write();
    if (this.isStale) this.view?.drawSheet();
    this.isStale = false;
  }

  recolour(): void {
    this.view?.recolour();
  }
}
