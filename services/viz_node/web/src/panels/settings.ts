import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import { Form, type Values } from "../form";
import type { Facts } from "../protocol";
import { settings } from "../schema";

const LINK_KEYS = ["delay_s", "jitter.scale_s", "loss.probability", "duplication.probability", "reordering.probability"];
const WAYS = [["forward", "Link, master to slave"], ["backward", "Link, slave to master"]] as const;

/** Parameters of the law and of each direction of the link: grey is what is in force, and only what is typed is sent. */
export class SettingsPanel implements Panel {
  private readonly lawPlace = make("div", { id: "law-form" });
  private readonly lawTitle = make("summary", {}, "Law");
  private lawForm: Form | undefined;
  private linkForms: Form[] = [];
  private readonly linkPlace = make("div");
  private readonly buttons: HTMLButtonElement[];
  private shownLaw = "";
  private shownLink = "";

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const button = (id: string, action: () => Promise<void>): HTMLButtonElement => make("button", { type: "button", id, onclick: () => void action() }, "Apply");
    this.buttons = [button("law-apply", () => this.apply("law", "controller", [this.lawForm])), button("link-apply", () => this.apply("link", "delay_node", this.linkForms))];
    root.append(make("details", { open: true }, this.lawTitle, this.lawPlace, this.buttons[0]!), this.linkPlace, this.buttons[1]!);
  }

  begin(): void {
    const { commands, store } = this.cockpit;
    for (const button of this.buttons) button.disabled = !commands.may;
    const schema = (store.forms["delay_node"] ?? {}) as Facts;
    this.linkForms = WAYS.map(([way]) => {
      const wanted = new Set(LINK_KEYS.map((key) => `${way}.${key}`));
      const sections = [way, `${way}.jitter`, `${way}.loss`, `${way}.duplication`, `${way}.reordering`];
      const found = sections.flatMap((section) => settings(schema, section)).filter((setting) => wanted.has(setting.key));
      return new Form(found.map((setting) => ({ ...setting, label: setting.key.slice(way.length + 1).replaceAll(/[._]/g, " ").replace(/ s$/, "") })), "link");
    });
    this.linkPlace.replaceChildren(...WAYS.map(([, title], i) => make("details", {}, make("summary", {}, title), this.linkForms[i]!.element)));
    this.fillLaw(this.shownLaw || String((store.forms["laws"] as string[] | undefined)?.[0] ?? ""));
    this.shownLaw = this.shownLink = "";
  }

  write(): void {
    const { store } = this.cockpit;
    const law = String(store.fact("law/status/master", "law") ?? "");
    if (law && law !== this.shownLaw) {
      this.shownLaw = law;
      this.fillLaw(law);
    }
    const link = store.state.get("link");
    const text = JSON.stringify([link?.["forward"], link?.["backward"]], (key, value: unknown) => (/queue|delay_m|delay_v|dropped/.test(key) ? undefined : value));
    if (!link || text === this.shownLink) return;
    this.shownLink = text;
    WAYS.forEach(([way], i) => {
      const facts = link[way] as { settings: Record<string, unknown> };
      this.linkForms[i]?.showInForce(Object.fromEntries(Object.entries(facts.settings).map(([key, value]) => [`${way}.${key}`, value])));
    });
  }

  private fillLaw(law: string): void {
    this.lawTitle.textContent = `Law ${law.replaceAll("_", " ")}`;
    this.lawForm = new Form(settings((this.cockpit.store.forms["controller"] ?? {}) as Facts, law), "law");
    this.lawPlace.replaceChildren(this.lawForm.element);
  }

  private async apply(about: string, target: string, forms: (Form | undefined)[]): Promise<void> {
    const found = forms.map((form) => form?.values());
    if (found.some((values, i) => forms[i] && !values)) return;
    const values = Object.assign({}, ...found) as Values;
    const { commands } = this.cockpit;
    if (!Object.keys(values).length) commands.show(about, false, "nothing was sent: type a value first (grey: the values in force)");
    else if (await commands.command(`${about}: ${Object.keys(values).join(", ")}`, "set", target, values)) forms.forEach((form) => form?.clear());
  }
}
