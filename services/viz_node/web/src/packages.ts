import type { Cockpit, Panel, PanelRow, Region } from "./cockpit";
import { colour, make, quantity, save } from "./dom";
import { numbers, type PanelAbout } from "./protocol";
import type { Regions } from "./regions";

/** What the module of a package's panel is given: all that a panel of the page has, and the helpers that it needs. */
export interface PanelApi extends Cockpit {
  /** Counts up when something here goes or changes its meaning. */
  version: 1;
  dom: { make: typeof make; colour: typeof colour; quantity: typeof quantity; save: typeof save };
  /** Numbers of an array of the wire. */
  numbers: typeof numbers;
  /** Ask the half of the panel in the server; the answer or the refusal is shown, and whether it was carried out returned. */
  ask(about: string, values: Record<string, string | number | boolean>): Promise<boolean>;
}

interface PanelModule {
  make(root: HTMLElement, api: PanelApi): Panel;
}

/** Brings panels of packages onto the page when the rig or the recording has what they show. */
export class PackagePanels {
  private rows: readonly PanelAbout[] = [];
  private readonly asked = new Set<string>();

  constructor(
    private readonly regions: Regions,
    private readonly cockpit: Cockpit,
    private readonly load: (url: string) => Promise<PanelModule> = (url) => import(/* @vite-ignore */ url) as Promise<PanelModule>,
  ) {}

  /** Take what the server says of the panels that are installed there, and of those that cannot be used. */
  begin(rows: readonly PanelAbout[], problems: readonly string[]): void {
    this.rows = rows;
    for (const problem of problems) {
      if (!this.asked.has(problem)) this.cockpit.commands.tell(problem);
      this.asked.add(problem);
    }
    this.follow();
  }

  /** Import the panels whose state has come. */
  follow(): void {
    for (const row of this.rows) {
      if (this.asked.has(row.id) || !this.shows(row)) continue;
      this.asked.add(row.id);
      void this.bring(row);
    }
  }

  private shows({ shows }: PanelAbout): boolean {
    return !shows || this.cockpit.store.state.has(shows);
  }

  private async bring(row: PanelAbout): Promise<void> {
    const failed = (error: unknown): void => this.cockpit.commands.show(`panel ${row.title}`, false, `${row.url}: ${error instanceof Error ? error.message : String(error)}`);
    if (this.regions.has(row.id)) return failed(`there is a panel ${row.id} already`);
    try {
      const module = await this.load(new URL(row.url, document.baseURI).href);
      const placed: PanelRow = { id: row.id, title: row.title, region: row.region as Region, shows: () => this.shows(row), make: (root) => guarded(module.make(root, this.api(row)), failed) };
      this.regions.add(placed);
    } catch (error) {
      failed(error);
    }
  }

  private api({ id }: PanelAbout): PanelApi {
    const ask = (about: string, values: Record<string, string | number | boolean>): Promise<boolean> => this.cockpit.commands.ask(about, { k: "panel", panel: id, values });
    return { ...this.cockpit, version: 1, dom: { make, colour, quantity, save }, numbers, ask };
  }
}

/** A panel that fails is told of once and no longer called: the page goes on. */
export function guarded(panel: Panel, failed: (error: unknown) => void): Panel {
  let isOver = false;
  const call = (name: keyof Panel, ...given: number[]): void => {
    if (isOver) return;
    try {
      (panel[name] as ((...given: number[]) => void) | undefined)?.apply(panel, given);
    } catch (error) {
      isOver = true;
      failed(error);
    }
  };
  return { begin: () => call("begin"), frame: (now) => call("frame", now), write: () => call("write"), recolour: () => call("recolour") };
}
