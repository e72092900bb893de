import { expect, it, vi } from "vitest";
import type { Cockpit, Panel, PanelRow } from "../src/cockpit";
import { PackagePanels, guarded, type PanelApi } from "../src/packages";
import type { PanelAbout } from "../src/protocol";
import type { Regions } from "../src/regions";

const WIND: PanelAbout = { id: "wind", title: "Wind", region: "watch", shows: "wind/speed", url: "./panels/wind/wind.js" };

function page(make: (root: HTMLElement, api: PanelApi) => Panel, taken: readonly string[] = []) {
  const state = new Map<string, Record<string, unknown>>();
  const said: string[] = [];
  const asked: unknown[] = [];
  const commands = {
    show: (about: string, ok: boolean, text: string) => said.push(`${about} ${ok} ${text}`),
    tell: (text: string) => said.push(text),
    ask: async (about: string, fields: unknown) => asked.push([about, fields]) > 0,
  };
  const rows: PanelRow[] = [];
  const panels: Panel[] = [];
  const cockpit = { store: { state }, commands } as unknown as Cockpit;
  const regions = {
    has: (id: string) => taken.includes(id),
    add: (row: PanelRow) => {
      rows.push(row);
      panels.push(row.make({} as HTMLElement, cockpit));
    },
  } as unknown as Regions;
  const load = vi.fn(async (url: string) => {
    expect(url).toBe("https://rig/panels/wind/wind.js");
    return { make };
  });
  vi.stubGlobal("document", { baseURI: "https://rig/" });
  return { packages: new PackagePanels(regions, cockpit, load), state, said, asked, rows, panels, load };
}

it("imports a panel once, when what it shows has come", async () => {
  const { packages, state, rows, load } = page(() => ({}));
  packages.begin([WIND], []);
  expect(load).not.toHaveBeenCalled();
  state.set("wind/speed", { speed_m_per_s: 2 });
  packages.follow();
  packages.follow();
  packages.begin([WIND], []);
  await vi.waitFor(() => expect(rows).toHaveLength(1));
  expect(load).toHaveBeenCalledTimes(1);
  expect(rows[0]!.shows!({} as Cockpit)).toBe(true);
  state.clear();
  expect(rows[0]!.shows!({} as Cockpit)).toBe(false);
});

it("lets a panel ask the server in its own name", async () => {
  const { packages, asked, panels } = page((_, api) => ({ begin: () => void api.ask("ventilate", { on: true }) }));
  packages.begin([{ ...WIND, shows: "" }], []);
  await vi.waitFor(() => expect(panels).toHaveLength(1));
  panels[0]!.begin!();
  expect(asked).toEqual([["ventilate", { k: "panel", panel: "wind", values: { on: true } }]]);
});

it("says what is wrong with a panel, and goes on", async () => {
  const broken = page(() => {
    throw new Error("no such sensor");
  });
  broken.packages.begin([{ ...WIND, shows: "" }], ["rain of the package rain 1.2 cannot be used: no licence"]);
  await vi.waitFor(() => expect(broken.said).toHaveLength(2));
  expect(broken.said).toEqual(["rain of the package rain 1.2 cannot be used: no licence", "panel Wind false ./panels/wind/wind.js: no such sensor"]);
  const taken = page(() => ({}), ["wind"]);
  taken.packages.begin([{ ...WIND, shows: "" }], []);
  await vi.waitFor(() => expect(taken.said[0]).toMatch(/there is a panel wind already/));
  expect(taken.rows).toHaveLength(0);
});

it("calls a panel that fails no more", () => {
  const said: unknown[] = [];
  let writes = 0;
  const panel = guarded(
    {
      write: () => {
        writes++;
        throw new Error("no such sensor");
      },
    },
    (error) => said.push(error),
  );
  for (let i = 0; i < 3; i++) panel.write!();
  panel.frame!(1);
  expect([writes, said.length]).toEqual([1, 1]);
});
