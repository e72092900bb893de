import type { Commands } from "./commands";
import type { Connection } from "./connection";
import type { Document } from "./document";
import type { Hand } from "./hand";
import type { Tip } from "./tip";
import type { Image } from "./image";
import type { Store } from "./store";

/** What every panel is given: what is known of the rig or the recording, and the ways to act on it. */
export interface Cockpit {
  store: Store;
  connection: Connection;
  commands: Commands;
  hand: Hand;
  tip: Tip;
  image: Image;
  document: Document;
}

/** The regions of the page, which docs/view.md draws. Panels of `dock` and `watch` are tabs where the window is narrow; on a phone one region is shown at a time. */
export type Region = "timeline" | "stage" | "scopes" | "controls" | "dock" | "watch";

/** What a panel does after it was built; each of these may be left out. */
export interface Panel {
  /** Called when a server has told who the page is, what it shows, and the forms of the nodes. */
  begin?(): void;
  /** Called with each frame [ms]. */
  frame?(now: number): void;
  /** Called five times a second: numbers are not read faster. */
  write?(): void;
  /** Called when the theme has changed. */
  recolour?(): void;
}

/** One row of the table of panels: a panel is one file and one row. */
export interface PanelRow {
  id: string;
  title: string;
  region: Region;
  /** Whether a panel of `watch` keeps a place beside the scopes where the others of that region are tabs. */
  pane?: boolean;
  /** Whether the panel is there at all, as an operator's panel is not on an observer's page; always, if left out. */
  shows?(cockpit: Cockpit): boolean;
  make(root: HTMLElement, cockpit: Cockpit): Panel;
}
