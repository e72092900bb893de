import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { bannersOf } from "../state";

/** Above every panel: what is shown, its state across the whole width, and the emergency stop at its end. */
export class StatusPanel implements Panel {
  text = "";
  private readonly banners = make("div", { id: "banners", role: "status", "aria-live": "polite" });
  private readonly source = make("span", { id: "source" });
  private readonly role = make("span", { id: "role" });
  private readonly stop = make("button", { type: "button", id: "estop", "aria-keyshortcuts": "Escape", onclick: () => void this.cockpit.commands.estop() });
  /** On a narrow window *Arm* is far below: this one stays within reach of the thumb while the rig is stopped. */
  private readonly rearm = make("button", { type: "button", id: "rearm", hidden: true, onclick: () => this.arm() }, "Arm hand and tip");
  private shown = "";
  private shownStop = "";

  constructor(
    private readonly root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const theme = make("button", { type: "button", id: "theme", class: "plain", "aria-label": "Light or dark" }, "Dark");
    const answers = make("div", { id: "answers", role: "log", "aria-live": "polite", "aria-label": "Answers to your actions" });
    root.append(make("h1", {}, "telenano"), make("div", { class: "about" }, this.source, this.role), make("div", { class: "said" }, this.banners, answers), theme, this.stop, this.rearm);
    addEventListener("keydown", (event) => {
      if (event.key === "Escape" && !event.repeat) void this.cockpit.commands.estop();
    });
    this.drawStop();
  }

  begin(): void {
    this.write();
  }

  write(): void {
    const { source, role, window } = this.cockpit.store;
    const { link } = this.cockpit.commands;
    const name = source.name.split("/").at(-1) ?? "";
    this.source.textContent = link !== "open" ? "" : source.kind === "recording" ? `recording ${name}` : "live";
    this.source.title = source.name;
    this.role.textContent = link !== "open" ? "" : role === "observer" ? "observer: looks, and may stop" : window ? `${role}, window ${window}` : role;
    document.title = link === "open" && window ? `telenano, window ${window}` : "telenano";
  }

  /** Show what an operator must not overlook, at its time and not with the frames, of which a slow machine draws few. */
  draw(): void {
    const { commands, store } = this.cockpit;
    const banners = bannersOf(store, commands.link, this.text);
    const text = JSON.stringify(banners);
    this.drawStop();
    this.drawRearm();
    if (text === this.shown) return;
    this.shown = text;
    this.root.dataset["state"] = banners[0]![0];
    this.banners.replaceChildren(...banners.map(([kind, words]) => make("span", { class: `banner ${kind}` }, words)));
  }

  /** Arm if the bar may be pressed now, which on a slow machine is drawn later than it is so. */
  private arm(): void {
    const { commands } = this.cockpit;
    if (commands.rearm(performance.now()) === "ready") void commands.arm();
  }

  private drawRearm(): void {
    const state = this.cockpit.commands.rearm(performance.now());
    this.rearm.hidden = state === "hidden";
    this.rearm.disabled = state !== "ready";
    document.body.toggleAttribute("data-rearm", state !== "hidden");
  }

  /** A stop that would stop nothing looks it, says so in its place, and says what does stop. */
  private drawStop(): void {
    const dead = this.cockpit.commands.deadStop;
    const key = dead?.short ?? "live";
    if (key === this.shownStop) return;
    this.shownStop = key;
    this.stop.toggleAttribute("data-dead", dead !== undefined);
    this.stop.setAttribute("aria-disabled", String(dead !== undefined));
    this.stop.disabled = dead !== undefined && this.cockpit.commands.link === "open";
    this.stop.title = dead?.long ?? "Stops both devices at once";
    if (!dead) this.stop.replaceChildren("EMERGENCY STOP ", make("kbd", {}, "Esc"));
    else {
      const hint = this.cockpit.store.source.kind === "recording" && this.cockpit.commands.link === "open" ? "a recording" : "type: telenano estop";
      this.stop.replaceChildren(dead.short, make("small", {}, hint));
    }
  }
}
