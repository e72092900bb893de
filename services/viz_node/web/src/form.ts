import { make } from "./dom";
import { compact, faultLine, faultOf, judge } from "./field";
import type { Setting } from "./schema";

export type Values = Record<string, number | boolean | string>;

/** Fields for settings, with units and limits; only those that a person has filled in are sent. */
export class Form {
  readonly element = make("div");
  private readonly inputs = new Map<string, HTMLInputElement | HTMLSelectElement>();
  private readonly faults = new Map<string, HTMLElement>();

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
        type: setting.kind === "boolean" ? "checkbox" : "text",
        ...(setting.kind !== "boolean" && setting.kind !== "text" && { inputmode: "decimal" }),
        ...(setting.kind !== "boolean" && { placeholder: shown(setting, setting.initial) }),
      });
      const row = make("div", { class: "field" }, make("label", { for: id, title: setting.about }, setting.label), input, make("span", { class: "quiet" }, setting.unit));
      if (input instanceof HTMLInputElement && setting.kind === "boolean") input.indeterminate = true;
      else if (input instanceof HTMLInputElement) {
        const fault = faultLine(input);
        this.faults.set(setting.key, fault);
        input.addEventListener("input", () => this.check(setting));
        row.append(fault);
      }
      this.inputs.set(setting.key, input);
      this.element.append(row);
    }
  }

  /** Show what is in force where nothing was typed; what is not among the values has its default. */
  showInForce(values: Record<string, unknown>): void {
    for (const setting of this.settings) {
      const input = this.inputs.get(setting.key)!;
      const value = shown(setting, values[setting.key] ?? setting.initial);
      if (input instanceof HTMLSelectElement) input.options[0]!.textContent = value;
      else if (input.type !== "checkbox") input.placeholder = value;
      else if (input.indeterminate) input.title = `in force: ${value}`;
    }
  }

  /** The values that were typed, in SI units; undefined where one cannot be, which its field then says. */
  values(): Values | undefined {
    const found: Values = {};
    let isRight = true;
    for (const setting of this.settings) {
      const input = this.inputs.get(setting.key)!;
      if (input instanceof HTMLInputElement && setting.kind === "boolean") {
        if (!input.indeterminate) found[setting.key] = input.checked;
      } else if (input.value !== "") {
        if (!this.check(setting)) isRight = false;
        found[setting.key] = setting.kind === "text" ? input.value : inUnits(Number(input.value), setting.scale);
      }
    }
    return isRight ? found : undefined;
  }

  /** Empty what was applied: it is in force now. */
  clear(): void {
    for (const input of this.inputs.values()) {
      input.value = "";
      if (input instanceof HTMLInputElement && input.type === "checkbox") input.indeterminate = true;
    }
  }

  private check(setting: Setting): boolean {
    const input = this.inputs.get(setting.key) as HTMLInputElement;
    const fault = this.faults.get(setting.key);
    if (!fault || setting.kind === "text") return true;
    return judge(input, fault, faultOf(input.value, setting.min, setting.max, setting.unit, setting.kind === "integer"));
  }
}

/** A typed number in SI units: divided, because 40 ms are then 0.04 s and not a neighbour of it. */
function inUnits(value: number, scale: number): number {
  return value / scale;
}

function shown(setting: Setting, value: unknown): string {
  // a default that the rig finds by itself is described where the field is pointed at
  if (value === null || value === undefined) return setting.about.includes("default: ") ? "auto" : "none";
  return typeof value === "number" ? compact(value * setting.scale) : String(value);
}

/** A choice whose first entry, the one in force, sends nothing. */
function selection(id: string, setting: Setting): HTMLSelectElement {
  const options = (setting.choices ?? []).map((choice) => make("option", { value: choice }, choice));
  return make("select", { id, title: setting.about }, make("option", { value: "" }, String(setting.initial ?? "as it is")), ...options);
}
