import type { Cockpit, Panel, PanelRow } from "./cockpit";
import { make, part } from "./dom";

/** From this width on the panels of `watch` have a column of their own, and are tabs otherwise. */
const WIDE = "(min-width: 1600px), (max-width: 1199px)";

/** From this width on those with a pane have one beside the scopes. */
const PANE = "(min-width: 1300px)";

interface Placed {
  row: PanelRow;
  root: HTMLElement;
  panel: Panel;
}

/** What a phone shows one at a time, with the panels or the region that each consists of. */
const PLACES: readonly (readonly [id: string, title: string, elements: readonly string[]])[] = [
  ["touch", "Touch", ["hand"]],
  ["scene", "Image", ["scene"]],
  ["scopes", "Scopes", ["scopes"]],
  ["controls", "Controls", ["controls"]],
  ["more", "More", ["dock", "watch"]],
];

/** Puts panels into the regions of the page; those of the dock share a place as tabs, and on a phone all regions do. */
export class Regions {
  readonly placed: Placed[] = [];
  private readonly tabs = make("div", { class: "tabs", role: "tablist", "aria-label": "Panels" });
  private readonly wide = matchMedia(WIDE);
  private readonly pane = matchMedia(PANE);
  private chosen = "";

  constructor(
    rows: readonly PanelRow[],
    private readonly cockpit: Cockpit,
  ) {
    part("dock").append(this.tabs);
    document.body.dataset["place"] = PLACES[0]![0];
    part("places").append(...PLACES.map(([id, title]) => make("button", { type: "button", id: `place-${id}`, "aria-pressed": String(id === PLACES[0]![0]), onclick: () => this.goTo(id) }, title)));
    for (const row of rows) this.place(row);
    for (const width of [this.wide, this.pane]) width.addEventListener("change", () => this.arrange());
    this.tabs.addEventListener("keydown", (event) => this.moveByKey(event));
    this.arrange();
  }

  /** Add a panel to the page that is open. */
  add(row: PanelRow): void {
    const { panel } = this.place(row);
    this.arrange();
    panel.begin?.();
  }

  /** Whether an element of the page is called so. */
  has(id: string): boolean {
    return document.getElementById(id) !== null;
  }

  private place(row: PanelRow): Placed {
    const hasTitle = row.region === "controls" || row.region === "watch";
    const root = make("section", { class: "panel", id: row.id, "aria-label": row.title }, ...(hasTitle ? [make("h2", {}, row.title)] : []));
    // what is longer than its place is scrolled with the keyboard as well
    if (row.region === "dock" || row.region === "watch") root.tabIndex = 0;
    // it measures its place while it is made
    part(row.region).append(root);
    try {
      const placed = { row, root, panel: row.make(root, this.cockpit) };
      this.placed.push(placed);
      return placed;
    } catch (error) {
      root.remove();
      throw error;
    }
  }

  /** The panel of a row, by its id. */
  panel(id: string): Panel {
    return this.placed.find(({ row }) => row.id === id)!.panel;
  }

  begin(): void {
    this.arrange();
    for (const { panel } of this.placed) panel.begin?.();
  }

  /** Show a place of the phone; on a wider window all are there. */
  private goTo(id: string): void {
    document.body.dataset["place"] = id;
    for (const button of part("places").children) button.setAttribute("aria-pressed", String(button.id === `place-${id}`));
  }

  private arrange(): void {
    const shown = this.placed.filter(({ row }) => row.shows?.(this.cockpit) ?? true);
    for (const { root } of this.placed) root.hidden = true;
    const tabs: Placed[] = [];
    for (const placed of shown) {
      const { row, root } = placed;
      root.hidden = false;
      const isWatched = row.region === "watch" && (this.wide.matches || (row.pane === true && this.pane.matches));
      if (row.region === "watch") part(isWatched ? "watch" : "dock").append(root);
      const isTab = row.region === "dock" || (row.region === "watch" && !isWatched);
      if (isTab) tabs.push(placed);
      root.setAttribute("role", isTab ? "tabpanel" : "region");
    }
    part("controls").hidden = !shown.some(({ row }) => row.region === "controls");
    part("timeline").hidden = !shown.some(({ row }) => row.region === "timeline");
    part("watch").hidden = !this.wide.matches && !this.pane.matches;
    part("dock").hidden = !tabs.length;
    for (const [id, , elements] of PLACES) part(`place-${id}`).hidden = elements.every((name) => part(name).hidden);
    this.tabs.replaceChildren(
      ...tabs.map(({ row }) => make("button", { type: "button", role: "tab", id: `tab-${row.id}`, "aria-controls": row.id, onclick: () => this.choose(row.id) }, row.title)),
    );
    const isThere = tabs.some(({ row }) => row.id === this.chosen);
    this.show(isThere ? this.chosen : (tabs[0]?.row.id ?? ""));
  }

  /** Show one of the panels that are tabs. */
  choose(id: string): void {
    this.chosen = id;
    this.show(id);
  }

  private show(id: string): void {
    for (const tab of this.tabs.children as Iterable<HTMLElement>) {
      const isChosen = tab.id === `tab-${id}`;
      tab.setAttribute("aria-selected", String(isChosen));
      tab.tabIndex = isChosen ? 0 : -1;
      part(tab.getAttribute("aria-controls")!).hidden = !isChosen;
    }
  }

  private moveByKey(event: KeyboardEvent): void {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!by) return;
    event.preventDefault();
    event.stopPropagation();
    const tabs = [...this.tabs.children] as HTMLElement[];
    const at = tabs.findIndex((tab) => tab.tabIndex === 0);
    const next = tabs[(at + by + tabs.length) % tabs.length]!;
    this.choose(next.getAttribute("aria-controls")!);
    next.focus();
  }
}
