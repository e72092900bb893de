import { make, part } from "./dom";
import type { LinkState } from "./connection";
import type { Store } from "./store";

type Banner = [kind: "good" | "warn" | "bad", text: string];

/** Nodes, events and the banners of what an operator must not overlook. */
export class Status {
  private readonly rows = make("tbody");
  private readonly list = make("ol", { tabindex: 0, "aria-label": "Events, newest first" });
  private shownEvents = 0;
  private connection: LinkState = "connecting";
  private connectionText = "";
  private lastBanners = "";

  constructor(private readonly store: Store) {
    const head = ["node", "state", "Hz", "late", "lost", "refused", "CPU"].map((name) => make("th", {}, name));
    part("nodes").append(make("h2", {}, "Nodes"), make("table", {}, make("thead", {}, make("tr", {}, ...head)), this.rows));
    part("events").append(make("h2", {}, "Events"), this.list);
  }

  setConnection(state: LinkState, text: string): void {
    this.connection = state;
    this.connectionText = text;
  }

  draw(): void {
    this.drawNodes();
    this.drawEvents();
    const { kind, name } = this.store.source;
    part("source").textContent = kind === "recording" ? `recording ${name}` : "live";
    part("source").title = name;
  }

  private banners(): Banner[] {
    const found: Banner[] = [];
    const { store } = this;
    if (this.connection !== "open") return [["bad", `DISCONNECTED: ${this.connectionText}`]];
    const nodes = [...store.nodes.values()];
    const isLive = store.source.kind === "live";
    if (!nodes.length) return [["warn", isLive ? "NO RIG: no node has reported yet" : "REPLAYED: not an instrument"]];
    if (isLive && nodes.every((node) => node.state === "ended" || node.state === "stopping")) return [["bad", "THE RIG HAS ENDED"]];
    if (store.fact("haptic/state/master", "estop") === true || store.fact("afm/state/slave", "mode") === "estop") {
      found.push(["bad", "EMERGENCY STOP: arm to go on"]);
    }
    const lost = this.store.lost();
    if (lost.length) found.push(["bad", `LOST: ${lost.join(", ")}`]);
    if (!isLive || nodes.some((node) => node.replay)) found.push(["warn", "REPLAYED: not an instrument"]);
    const delays = ["forward", "backward"].map((way) => {
      const facts = store.fact("link", way) as { delay_valid?: boolean; delay_mean_s?: number } | undefined;
      return facts?.delay_valid ? (facts.delay_mean_s ?? 0) : 0;
    });
    const delay = delays[0]! + delays[1]!;
    if (delay > 1e-3) found.push(["warn", `DELAYED: ${(delay * 1e3).toFixed(1)} ms round trip`]);
    if (store.fact("law/status/master", "passive") === false) found.push(["warn", "NOT PASSIVE"]);
    if (!found.length) found.push(["good", "running"]);
    return found;
  }

  /** Show what an operator must not overlook. */
  drawBanners(): void {
    const banners = this.banners();
    const text = JSON.stringify(banners);
    if (text === this.lastBanners) return;
    this.lastBanners = text;
    part("banners").replaceChildren(...banners.map(([kind, words]) => make("span", { class: `banner ${kind}` }, words)));
  }

  private drawNodes(): void {
    const lost = new Set(this.store.lost());
    const rows = [...this.store.nodes].sort(([a], [b]) => a.localeCompare(b)).map(([name, node]) => {
      const state = lost.has(name) ? "lost" : node.state;
      const kind = lost.has(name) || node.state === "stopping" ? "bad" : node.state === "safe" ? "warn" : "";
      const late = node.lateness_p99_s > 0 ? `${(node.lateness_p99_s * 1e3).toFixed(2)} ms` : "";
      const cells = [name, state, node.rate_hz.toFixed(0), late, String(node.lost), String(node.rejected), `${node.cpu_percent.toFixed(0)} %`];
      return make("tr", { class: kind }, ...cells.map((cell) => make("td", {}, cell)));
    });
    this.rows.replaceChildren(...rows);
  }

  private drawEvents(): void {
    if (this.store.events.length === this.shownEvents && this.list.childElementCount) return;
    this.shownEvents = this.store.events.length;
    const newest = this.store.events.slice(-60).reverse();
    this.list.replaceChildren(
      ...newest.map((event) =>
        make("li", { class: event.level }, `${new Date(event.t / 1e6).toLocaleTimeString()} ${event.src}: ${event.text}`),
      ),
    );
  }
}
