import address from "../../gallery/networks.json?url";
import { adviceIn, delayText, lineText, measuredText, type Way } from "../link";
import { ageText, agesOf } from "../age";
import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { faultLine, faultOf, judge } from "../field";
import { LinePictures, type LineData } from "../linecurves";

const MOST_MS = 2000;
/** Profiles that are not a measured network, and the row that shows those. */
const PLAIN = ["clean", "lan", "wifi", "lte", "5g", "transatlantic", "satellite"];
const MORE = "…";
const WAYS = ["forward", "backward"] as const;

/** The link: its profile, what a measured one does, its delay, and what that means. Each direction is among the settings. */
export class LinkPanel implements Panel {
  private readonly profile = make("select", { id: "profile", "aria-label": "Profile of the link" });
  private readonly delay = make("input", { id: "delay", type: "text", inputmode: "decimal", placeholder: "one way", "aria-label": "Delay one way, both directions, in ms" });
  private readonly set = make("button", { type: "button", id: "delay-set", onclick: () => this.setDelay() }, "Set");
  private readonly fault = faultLine(this.delay);
  private readonly measured = make("div", { class: "quiet linkline", id: "measured" });
  /** What an adviser of an installed package warns of, such as the table of the benchmark. */
  private readonly advice = make("div", { class: "warning linkline", id: "advice", role: "status", hidden: true });
  /** The largest part of the latency, and under it all parts: by pointer, touch and keyboard alike. */
  private readonly age = { short: make("summary", {}), long: make("div", { class: "quiet linkline" }) };
  private readonly ageRoot = make("details", { id: "age", hidden: true }, this.age.short, this.age.long);
  private readonly line = make("div", { class: "quiet linkline", id: "line" });
  private readonly pictures = new LinePictures(make("div", { class: "linecurves", id: "line-curves", hidden: true }), () => fetch(address).then((answer) => answer.json() as Promise<LineData>));
  /** What is in force but in no list of profiles, such as `custom`; it cannot be chosen. */
  private readonly other = make("option", { disabled: true });
  private isWide = false;
  private shown = "";
  private delayShown = "";

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    this.profile.addEventListener("change", () => this.choose());
    this.delay.addEventListener("input", () => this.check());
    this.delay.addEventListener("keydown", (event) => event.key === "Enter" && this.setDelay());
    root.append(make("div", { class: "row wrap" }, this.profile, this.delay, make("span", { class: "quiet" }, "ms"), this.set), this.fault, this.measured, this.advice, this.line, this.ageRoot, this.pictures.root);
  }

  begin(): void {
    const { store, commands } = this.cockpit;
    const profiles = (store.forms["profiles"] ?? []) as string[];
    const option = (name: string): HTMLOptionElement => make("option", { value: name }, profileName(name));
    // what is chosen most is in sight, and the measured networks behind a press
    const [near, far] = [profiles.filter((name) => PLAIN.includes(name)), profiles.filter((name) => !PLAIN.includes(name))];
    this.profile.replaceChildren(...near.map(option));
    if (far.length) this.profile.append(this.isWide ? make("optgroup", { label: "Networks" }, ...far.map(option)) : make("option", { value: MORE }, `${far.length} more …`));
    for (const input of [this.profile, this.delay, this.set]) input.disabled = !commands.may;
    this.shown = this.delayShown = "";
    this.write();
  }

  write(): void {
    const { store } = this.cockpit;
    const ways = WAYS.map((way) => store.fact("link", way) as Way | undefined);
    const profile = ways[0]?.profile ?? "";
    if (profile && profile !== this.shown) {
      this.shown = profile;
      this.other.remove();
      if (![...this.profile.options].some((option) => option.value === profile)) {
        this.other.value = profile;
        this.other.textContent = profileName(profile);
        this.profile.prepend(this.other);
      }
      this.profile.value = profile;
      void this.pictures.show(profile);
    }
    const losses = ["forward_loss", "backward_loss"].map((column) => store.last("link", column));
    const measured = measuredText(ways, losses);
    if (this.measured.textContent !== measured) this.measured.textContent = measured;
    const advice = adviceIn(store.events, String(store.fact("law/status/master", "law") ?? ""));
    if (this.advice.textContent !== advice) this.advice.textContent = advice;
    this.advice.hidden = !advice;
    const line = lineText(WAYS.map((way) => ["queue_s", "capacity_bit_per_s", "sends", "blocked_since_ns"].map((key) => store.fact(`line/${way}`, key))));
    if (this.line.textContent !== line) this.line.textContent = line;
    const { short, long } = ageText(agesOf(store.age, store.wayS, store.pictureS, store.frameS));
    if (this.age.short.textContent !== short) this.age.short.textContent = short;
    if (this.age.long.textContent !== long) this.age.long.textContent = long;
    this.ageRoot.hidden = !short;
    // an empty field shows what is in force, as those of the settings do; what somebody is typing stays
    const delay = delayText(ways);
    if (delay === this.delayShown) return;
    this.delayShown = delay;
    this.delay.placeholder = delay || "one way";
    if (document.activeElement !== this.delay) this.delay.value = "";
  }

  /** Set the profile that was chosen; the last row of the short list shows the long one instead. */
  private choose(): void {
    const { value } = this.profile;
    if (value !== MORE) void this.cockpit.commands.command(`profile ${value}`, "set", "delay_node", { profile: value });
    else {
      this.isWide = true;
      this.begin();
      this.profile.focus();
    }
  }

  private check(): boolean {
    return judge(this.delay, this.fault, faultOf(this.delay.value, 0, MOST_MS, "ms"));
  }

  private setDelay(): void {
    if (!this.check()) return;
    if (this.delay.value.trim() === "") {
      judge(this.delay, this.fault, `type a delay from 0 to ${MOST_MS} ms`);
      return;
    }
    const delay_s = Number(this.delay.value) / 1e3;
    void this.cockpit.commands.command(`delay ${this.delay.value} ms one way`, "set", "delay_node", { "forward.delay_s": delay_s, "backward.delay_s": delay_s });
  }
}

/** A profile by its name, and that of the plain link with what it means. */
function profileName(name: string): string {
  return name === "clean" ? "clean: no delay" : name.replaceAll("_", " ");
}
