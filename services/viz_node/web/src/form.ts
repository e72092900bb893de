import { make } from "./dom";
import type { Setting } from "./schema";

export type Values = Record<string, number | boolean | string>;

/** Fields for settings, with units and limits; only those that a person has filled in are sent. */
export class Form {
  readonly element = make("div");
  private readonly inputs = new Map<string, HTMLInputElement | HTMLSelectElement>();

  constructor(
    private readonly settings: Setting[],
    prefix: string,
  ) {
    for (const setting of settings) {
      const id = `${prefix}-${setting.key.replaceAll(".", "-")}`;
      const limits = setting.min !== undefined || setting.max !== undefined ? ` [${setting.min ?? "−∞"}, ${setting.max ?? "∞"}]` : "";
      const input = setting.choices ? selection(id, setting) : make("input", {
        id,
        title: `${setting.about}${limits}`,
        type: setting.kind === "boolean" ? "checkbox" : setting.kind === "text" ? "text" : "number",
        ...(setting.kind === "number" && { step: "any" }),
        ...(setting.min !== undefined && { min: setting.min }),
        ...(setting.max !== undefined && { max: setting.max }),
        ...(setting.kind !== "boolean" && { placeholder: String(setting.initial ?? "none") }),
      });
      if (input instanceof HTMLInputElement && setting.kind === "boolean") input.indeterminate = true;
      this.inputs.set(setting.key, input);
      this.element.append(make("div", { class: "field" }, make("label", { for: id, title: setting.about }, setting.label), input, make("span", { class: "quiet" }, setting.unit)));
    }
  }

  /** Show what is in force where nothing was typed; what is not among the values has its default. */
  showInForce(values: Record<string, unknown>): void {
    for (const setting of this.settings) {
      const input = this.inputs.get(setting.key)!;
      const value = String(values[setting.key] ?? setting.initial ?? "none");
      if (input instanceof HTMLSelectElement) input.options[0]!.textContent = value;
      else if (input.type !== "checkbox") input.placeholder = value;
      else if (input.indeterminate) input.title = `in force: ${value}`;
    }
  }

  values(): Values {
    const found: Values = {};
    for (const setting of this.settings) {
      const input = this.inputs.get(setting.key)!;
      if (input instanceof HTMLInputElement && setting.kind === "boolean") {
        if (!input.indeterminate) found[setting.key] = input.checked;
      } else if (input.value !== "") found[setting.key] = setting.kind === "text" ? input.value : Number(input.value);
    }
    return found;
  }

  /** Empty what was applied: it is in force now. */
  clear(): void {
    for (const input of this.inputs.values()) {
      input.value = "";
      if (input instanceof HTMLInputElement && input.type === "checkbox") input.indeterminate = true;
    }
  }
}

/** A choice whose first entry, the one in force, sends nothing. */
function selection(id: string, setting: Setting): HTMLSelectElement {
  const options = (setting.choices ?? []).map((choice) => make("option", { value: choice }, choice));
  return make("select", { id, title: setting.about }, make("option", { value: "" }, String(setting.initial ?? "as it is")), ...options);
}
