import type { Cockpit, Panel } from "../cockpit";
import { MEANINGS } from "../colours";
import { make } from "../dom";

/** What a first operator does, each by steps that need no document. */
const TASKS: readonly (readonly [title: string, steps: readonly string[]])[] = [
  ["Touch with 10 nN", ["Press the filled button at the top again and again until it says Hold the hand, and press that too.", "Drag the blue hand down in its picture, or press ↓ on it, until the tip touches the sample.", "Go on slowly until Force on the tip says 10 nN. Let go ends it."]],
  ["Hold for 5 s", ["Touch the sample as above, with Keep holding pressed: the hand then stays by itself.", "Wait until Force on the tip has come to rest, and watch it for 5 s. If the top line turns red, press softer or choose another law.", "Press Let go."]],
  ["Find the softest of three places", ["At Tip to enter x and y of the first place, and press Move.", "Hold the hand and lower it until you feel 0.5 N; read Hand. Lower it until you feel 1 N; read Hand again.", "Let go, and do the same at the other places. The softest is where the hand went furthest from 0.5 N to 1 N."]],
  ["Take an image and go to a particle", ["This needs a sample with particles: where the rig runs, telenano up image starts one, and touch has a plane of mica.", "Press Image. The lines appear in the scene, and Flat above it shows them from above; wait until the top line no longer says Image.", "Press By hand, and then the filled button at the top: the tip goes back.", "Choose Move tip above the scene, and press on the particle: the tip goes there and keeps its height."]],
  ["Say why it feels late", ["At Link read Largest part of the latency: it names what takes most of the time.", "Press it to see all parts. The yellow DELAYED at the top is what the link alone adds.", "If your network is the largest, come nearer or take a cable; if it is the link, choose a law that is made for delay."]],
];

const WORDS: readonly (readonly [word: string, meaning: string])[] = [
  ["Tip", "the point of the instrument that touches the sample"],
  ["Arm", "allow hand and tip to move; it starts no motion by itself"],
  ["Withdrawn", "the tip is far above the sample and stays there"],
  ["Meniscus", "a bridge of water between tip and sample: it pulls them together"],
  ["Law", "the control law that joins hand and tip over the delay"],
  ["Link", "the network between hand and tip, with the delay that is set on purpose"],
  ["Cantilever", "the spring that carries the tip: how far it bends tells the force"],
  ["nN, nm", "a billionth of a newton, a billionth of a metre"],
];

/** Five tasks in written steps, what each colour means, and the words. */
export class HelpPanel implements Panel {
  constructor(root: HTMLElement, cockpit: Cockpit) {
    void cockpit;
    root.append(
      make("h3", {}, "First tasks"),
      ...TASKS.map(([title, steps], i) => make("details", { open: i === 0 }, make("summary", {}, title), make("ol", { class: "task" }, ...steps.map((step) => make("li", {}, step))))),
      make("h3", {}, "Colours"),
      make("ul", { class: "legend-of-colours" }, ...MEANINGS.map(({ tokens, name, words }) => {
        const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
        swatch.style.background = `var(--${tokens[0]!})`;
        return make("li", {}, swatch, make("span", {}, make("b", {}, name), `: ${words}`));
      })),
      make("h3", {}, "Words"),
      make("dl", { class: "words-of-page" }, ...WORDS.flatMap(([word, meaning]) => [make("dt", {}, word), make("dd", {}, meaning)])),
      make("h3", {}, "Keys"),
      make("p", { class: "quiet" }, "Esc stops. n does what is next, g lets the tip go back, w keeps it withdrawn, u lets go of the hand, d presses a little more, h takes or asks for control. On the hand ↓ and ↑ press. c shows cursors, p pauses the scopes, m marks, o lets hand and tip meet again."),
    );
  }
}
