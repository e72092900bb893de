import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { bannersOf, type Banner } from "../state";

/** Above every panel: what is shown, its state across the whole width, and the emergency stop at its end. */
export class StatusPanel implements Panel {
  private readonly banners = make("div", { id: "banners", role: "status", "aria-live": "polite" });
  private readonly source = make("span", { id: "source" });
  private readonly role = make("span", { id: "role" });
  private readonly stop = make("button", { type: "button", id: "estop", "aria-keyshortcuts": "Escape", onclick: () => void this.cockpit.commands.estop() });
  private shown = "";
  private shownStop = "";
  private seen: Banner[] = [];

  constructor(
    private readonly root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const theme = make("button", { type: "button", id: "theme", class: "plain", "aria-label": "Light or dark" }, "Dark");
    root.append(make("h1", {}, "telenano"), make("div", { class: "about" }, this.source, this.role), make("div", { class: "said" }, this.banners), make("div", { id: "control" }), theme, this.stop);
    addEventListener("keydown", (event) => {
      if (event.key === "Escape" && !event.repeat) void this.cockpit.commands.estop();
    });
    this.drawStop();
  }

  begin(): void {
    this.look();
    this.write();
  }

  write(): void {
    this.drawBanners();
    const { source, role, window } = this.cockpit.store;
    const { link } = this.cockpit.commands;
    const name = source.name.split("/").at(-1) ?? "";
    this.source.textContent = link !== "open" ? "" : source.kind === "recording" ? `recording ${name}` : "live";
    this.source.title = source.name;
    this.role.textContent = link !== "open" ? "" : role === "observer" ? "observer: can look, and stop the rig" : window ? `${role}, window ${window}` : role;
    document.title = link === "open" && window ? `telenano, window ${window}` : "telenano";
  }

  /** See what an operator must not overlook in the instant that is shown; return what of it is seen at once, without its numbers. */
  look(): string {
    const { commands, store } = this.cockpit;
    this.seen = bannersOf(store, commands.link, commands.linkText);
    this.drawStop();
    return this.seen.map(([kind, words]) => `${kind} ${words.replace(/[\d.]+/g, "")}`).join();
  }

  private drawBanners(): void {
    const banners = this.seen;
    const text = JSON.stringify(banners);
    if (!banners.length || text === this.shown) return;
    this.shown = text;
    this.root.dataset["state"] = banners[0]![0];
    this.banners.replaceChildren(...banners.map(([kind, words]) => make("span", { class: `banner ${kind}` }, words)));
    this.banners.title = banners.map(([, words]) => words).join("\n");
  }

  /** A stop that would stop nothing looks it, says so in its place, and says what does stop. */
  private drawStop(): void {
    const dead = this.cockpit.commands.deadStop;
    const key = dead?.short ?? "live";
    if (key === this.shownStop) return;
    this.shownStop = key;
    this.stop.toggleAttribute("data-dead", dead !== undefined);
    this.stop.setAttribute("aria-disabled", String(dead !== undefined));
    this.stop.disabled = dead !== undefined && this.cockpit.store.source.kind === "recording" && this.cockpit.commands.link === "open";
    this.stop.title = dead?.long ?? "Stops both devices at once";
    if (!dead) this.stop.replaceChildren("EMERGENCY STOP ", make("kbd", {}, "Esc"));
    else {
      const hint = this.cockpit.store.source.kind === "recording" && this.cockpit.commands.link === "open" ? "a recording" : "type: telenano estop";
      this.stop.replaceChildren(dead.short, make("small", {}, hint));
    }
  }
}
