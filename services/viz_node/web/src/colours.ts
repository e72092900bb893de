/** What a colour says, wherever it is on the page; the tokens are those of styles.css. */
export interface Meaning {
  /** The custom properties that have it, without their dashes; the first is shown in the legend. */
  tokens: readonly string[];
  name: string;
  words: string;
}

/** The legend of the page: one colour, one meaning. The panel *Help* shows it, and a test reads the stylesheet by it. */
export const MEANINGS: readonly Meaning[] = [
  { tokens: ["hand"], name: "Blue", words: "your hand: where it is, and what it presses with" },
  { tokens: ["tip"], name: "Orange", words: "the tip: the force on it, and what comes back to you" },
  { tokens: ["water"], name: "Cyan", words: "the water bridge (meniscus) between tip and sample, which pulls" },
  { tokens: ["lateral"], name: "Violet", words: "force and way across the sample" },
  { tokens: ["sample"], name: "Brown", words: "the sample" },
  { tokens: ["extra"], name: "Magenta", words: "a further curve that somebody has added to a scope" },
  { tokens: ["good", "good-back"], name: "Green", words: "as it should be" },
  { tokens: ["warn", "warn-back"], name: "Yellow", words: "to know before you trust what you see or feel" },
  { tokens: ["bad", "bad-back", "stop", "stop-over"], name: "Red", words: "something is wrong; full red is the emergency stop alone" },
  { tokens: ["accent"], name: "Dark fill", words: "what to do next: there is one such button at a time" },
];
