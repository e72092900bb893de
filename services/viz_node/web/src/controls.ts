import type { Connection } from "./connection";
import { make, part } from "./dom";
import { Form, type Values } from "./form";
import type { Facts } from "./protocol";
import { settings } from "./schema";
import { Stops } from "./stops";
import type { Store } from "./store";

const SHOWN_MS = 7000;
/** The AFM before the haptic device, so that the hand never moves a reference that nothing follows. */
const DEVICES = ["afm_node", "haptic_node"];
const LINK_KEYS = ["delay_s", "jitter.scale_s", "loss.probability", "duplication.probability", "reordering.probability"];

/** Commands of the operator; each shows its acknowledgement or its refusal. */
export class Controls {
  readonly stops = new Stops(() => ({
    afm_node: this.store.fact("afm/state/slave", "mode") === "estop",
    haptic_node: this.store.fact("haptic/state/master", "estop") === true,
  }));
  private readonly law = part("law");
  private readonly link = part("link");
  private lawForm: Form | undefined;
  private linkForms: Form[] = [];
  private shownLaw = "";
  private shownLink = "";

  constructor(
    private readonly connection: Connection,
    private readonly store: Store,
  ) {
    part("estop").addEventListener("click", () => void this.estop());
    addEventListener("keydown", (event) => {
      if (event.key === "Escape" && !event.repeat) void this.estop();
    });
  }

  /** Build the controls that the role and the source permit. */
  build(): void {
    const { role, commands, source } = this.store;
    const may = role === "operator" && commands;
    part("role").textContent = role === "observer" ? "observer: looks, does not command" : "operator";
    (part("estop") as HTMLButtonElement).disabled = !may;
    for (const id of ["session", "law", "link"]) part(id).hidden = !commands;
    this.buildTransport(source.kind === "recording");
    if (!commands) return;
    this.buildSession(may);
    this.buildLaw(may);
    this.buildLink(may);
  }

  /** Show what is in force. */
  draw(): void {
    this.drawTransport();
    const law = String(this.store.fact("law/status/master", "law") ?? "");
    if (law && law !== this.shownLaw) {
      this.shownLaw = law;
      const select = document.getElementById("law-name") as HTMLSelectElement | null;
      if (select) select.value = law;
      this.fillLaw(law);
    }
    const link = this.store.state.get("link");
    const text = JSON.stringify([link?.["forward"], link?.["backward"]], (key, value: unknown) => (/queue|delay_m|delay_v|dropped/.test(key) ? undefined : value));
    if (link && text !== this.shownLink) {
      this.shownLink = text;
      ["forward", "backward"].forEach((way, i) => {
        const facts = link[way] as { settings: Record<string, unknown>; profile: string };
        this.linkForms[i]?.showInForce(Object.fromEntries(Object.entries(facts.settings).map(([key, value]) => [`${way}.${key}`, value])));
        const select = document.getElementById("profile") as HTMLSelectElement | null;
        if (select && i === 0) select.value = facts.profile;
      });
    }
  }

  /** Called when an emergency stop is asked for, before it is answered. */
  onEstop: () => void = () => {};

  async estop(): Promise<void> {
    this.stops.note();
    this.onEstop();
    await this.ask("emergency stop", { k: "estop" });
  }

  async command(about: string, command: string, target: string, parameters: Values = {}): Promise<boolean> {
    return this.ask(about, { k: "command", command, target, parameters });
  }

  /** Arm the devices one after the other, as far as they permit, and no further than to the next emergency stop. */
  async arm(mayGoOn = this.stops.begin()): Promise<void> {
    for (const device of DEVICES) if (!mayGoOn() || !(await this.command(`arm ${device}`, "arm", device))) return;
  }

  private async ask(about: string, fields: Facts): Promise<boolean> {
    const note = make("div", { class: "answer pending" }, `${about} …`);
    part("answers").append(note);
    const answer = await this.connection.ask(fields);
    note.className = `answer ${answer.ok ? "done" : "refused"}`;
    note.textContent = `${about}: ${answer.ok ? "acknowledged" : "refused"} · ${answer.text}`;
    setTimeout(() => note.remove(), SHOWN_MS);
    return answer.ok;
  }

  private buildSession(may: boolean): void {
    const button = (id: string, text: string, action: () => Promise<unknown>): HTMLButtonElement =>
      make("button", { type: "button", id, disabled: !may, onclick: () => void action() }, text);
    const mark = make("input", { id: "mark-text", type: "text", placeholder: "what it marks", "aria-label": "Text of the mark", disabled: !may, maxlength: 200 });
    const row = make("div", { class: "row" });
    row.append(
      button("start", "Start", () => this.command("start", "start", "haptic_node")),
      button("stop", "Stop", () => this.command("stop", "stop", "haptic_node")),
      button("arm", "Arm", () => this.arm()),
    );
    const second = make("div", { class: "row" });
    second.append(
      mark,
      button("mark", "Mark", () => this.command("mark", "mark", "recorder", { text: mark.value || "mark" })),
      button("split", "New file", () => this.command("begin a new file", "set", "recorder", { "record.split": true })),
    );
    part("session").replaceChildren(make("h2", {}, "Session"), row, second);
  }

  private buildLaw(may: boolean): void {
    const laws = (this.store.forms["laws"] ?? []) as string[];
    const select = make("select", { id: "law-name", "aria-label": "Law", disabled: !may }, ...laws.map((law) => make("option", { value: law }, law.replaceAll("_", " "))));
    select.addEventListener("change", () => {
      void this.command(`law ${select.value}`, "set", "controller", { law: select.value }).then((ok) => {
        if (!ok) select.value = this.shownLaw;
      });
    });
    const place = make("div", { id: "law-form" });
    const apply = make("button", { type: "button", id: "law-apply", disabled: !may, onclick: () => void this.apply("law", "controller", [this.lawForm]) }, "Apply");
    this.law.replaceChildren(make("h2", {}, "Law"), select, make("details", {}, make("summary", {}, "Parameters"), place, apply));
    this.fillLaw(select.value);
  }

  private fillLaw(law: string): void {
    const schema = (this.store.forms["controller"] ?? {}) as Facts;
    this.lawForm = new Form(settings(schema, law), "law");
    document.getElementById("law-form")?.replaceChildren(this.lawForm.element);
  }

  private buildLink(may: boolean): void {
    const schema = (this.store.forms["delay_node"] ?? {}) as Facts;
    const profiles = ["custom", ...((this.store.forms["profiles"] ?? []) as string[])];
    const select = make("select", { id: "profile", "aria-label": "Profile of the link", disabled: !may }, ...[...new Set(profiles)].map((name) => make("option", { value: name, disabled: name === "custom" }, name)));
    select.addEventListener("change", () => void this.command(`profile ${select.value}`, "set", "delay_node", { profile: select.value }));
    const delay = make("input", { id: "delay", type: "number", min: 0, max: 2000, step: "any", placeholder: "one way", "aria-label": "Delay one way, both directions, in ms", disabled: !may });
    const set = (): void => {
      if (!delay.checkValidity() || delay.value === "") return;
      const delay_s = Number(delay.value) / 1e3;
      void this.command(`delay ${delay.value} ms one way`, "set", "delay_node", { "forward.delay_s": delay_s, "backward.delay_s": delay_s });
    };
    delay.addEventListener("keydown", (event) => {
      if (event.key === "Enter") set();
    });
    const row = make("div", { class: "row" }, select, delay, "ms", make("button", { type: "button", id: "delay-set", disabled: !may, onclick: set }, "Set"));
    this.linkForms = ["forward", "backward"].map((way) => {
      const wanted = new Set(LINK_KEYS.map((key) => `${way}.${key}`));
      const sections = [way, `${way}.jitter`, `${way}.loss`, `${way}.duplication`, `${way}.reordering`];
      const found = sections.flatMap((section) => settings(schema, section)).filter((setting) => wanted.has(setting.key));
      return new Form(found.map((setting) => ({ ...setting, label: setting.key.slice(way.length + 1).replaceAll(/[._]/g, " ").replace(/ s$/, "") })), "link");
    });
    const details = make("details", {}, make("summary", {}, "Each direction"));
    ["Master to slave", "Slave to master"].forEach((name, i) => details.append(make("div", { class: "quiet" }, name), this.linkForms[i]!.element));
    details.append(make("button", { type: "button", id: "link-apply", disabled: !may, onclick: () => void this.apply("link", "delay_node", this.linkForms) }, "Apply"));
    this.link.replaceChildren(make("h2", {}, "Link"), row, details);
    this.shownLink = "";
  }

  private async apply(about: string, target: string, forms: (Form | undefined)[]): Promise<void> {
    const values = Object.assign({}, ...forms.map((form) => form?.values())) as Values;
    if (!Object.keys(values).length) return;
    if (await this.command(`${about}: ${Object.keys(values).join(", ")}`, "set", target, values)) forms.forEach((form) => form?.clear());
  }

  private buildTransport(shown: boolean): void {
    const bar = part("transport");
    bar.hidden = !shown;
    if (!shown) return;
    const may = this.store.role === "operator";
    const ask = (action: string, value = 0): void => void this.ask(action, { k: "transport", action, value });
    const place = make("input", { id: "place", type: "range", min: 0, step: 0.01, "aria-label": "Place in the recording", disabled: !may });
    place.addEventListener("change", () => ask("seek", Number(place.value)));
    const rate = make("select", { id: "rate", "aria-label": "Rate", disabled: !may }, ...[0.1, 0.25, 0.5, 1, 2, 5, 10].map((r) => make("option", { value: r, selected: r === 1 }, `${r} ×`)));
    rate.addEventListener("change", () => ask("rate", Number(rate.value)));
    const play = make("button", { type: "button", id: "play", disabled: !may, onclick: () => ask(this.store.source.playing ? "pause" : "play") }, "Pause");
    bar.replaceChildren(play, place, make("span", { id: "place-text" }), rate);
  }

  private drawTransport(): void {
    const { source } = this.store;
    if (source.kind !== "recording") return;
    const place = document.getElementById("place") as HTMLInputElement | null;
    if (!place) return;
    place.max = String(source.length_s ?? 0);
    if (document.activeElement !== place || source.playing) place.value = String(source.position_s ?? 0);
    part("place-text").textContent = `${(source.position_s ?? 0).toFixed(1)} of ${(source.length_s ?? 0).toFixed(1)} s`;
    part("play").textContent = source.playing ? "Pause" : "Play";
  }
}
