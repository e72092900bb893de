import { make } from "../dom";
import { faultLine, judge } from "../field";
import type { Store } from "../store";
import { catalog, drawnAs, type CurveRef } from "./catalog";
import type { ScopeSpec } from "./layout";

/** What a person does to a scope beside choosing its curves. */
export interface SheetActions {
  change(spec: ScopeSpec): void;
  move(by: number): void;
  overlay(): void;
  remove(): void;
  close(): void;
}

const MOST_CURVES = 6;

/** The sheet of one scope: its curves, its range, and its place; it lies over the scopes and holds nothing up. */
export function sheetOf(store: Store, spec: ScopeSpec, actions: SheetActions): HTMLElement {
  const title = make("input", { id: "scope-title", type: "text", value: spec.title, maxlength: 60, "aria-label": "Name of the scope" });
  title.addEventListener("change", () => actions.change({ ...spec, title: title.value || spec.title }));
  const fault = make("div", { class: "fault", role: "alert" });
  const kind = make("select", { id: "scope-kind", "aria-label": "Drawn as" }, ...[["time", "over time"], ["spectrum", "spectrum"]].map(([value, text]) => make("option", { value: value!, selected: value === spec.kind }, text!)));
  kind.addEventListener("change", () => actions.change({ ...spec, kind: kind.value as ScopeSpec["kind"] }));
  const button = (id: string, text: string, action: () => void): HTMLButtonElement => make("button", { type: "button", id, onclick: action }, text);
  const sheet = make("div", { class: "sheet", id: "scope-sheet", role: "region", "aria-label": `Scope ${spec.title}` });
  sheet.append(
    make("div", { class: "row tight" }, title, ...(spec.kind === "distance" ? [] : [kind]), make("span", { class: "spacer" }), button("scope-close", "Close", actions.close)),
    ...(spec.kind === "distance" ? [] : [rangeOf(store, spec, actions), fault, ...curvesOf(store, spec, actions, fault)]),
    make("div", { class: "row" }, button("scope-earlier", "Earlier", () => actions.move(-1)), button("scope-later", "Later", () => actions.move(1)), button("scope-overlay", "Overlay on the one before", actions.overlay), make("span", { class: "spacer" }), button("scope-remove", "Remove", actions.remove)),
  );
  return sheet;
}

function rangeOf(store: Store, spec: ScopeSpec, actions: SheetActions): HTMLElement {
  const unit = spec.curves[0] ? drawnAs(store, spec.curves[0]).unit : "";
  const field = (id: string, label: string, value: number | undefined): HTMLInputElement => make("input", { id, type: "number", step: "any", "aria-label": `${label} in ${unit}`, value: value ?? "" });
  const [low, high] = [field("scope-low", "Least", spec.range?.[0]), field("scope-high", "Greatest", spec.range?.[1])];
  const fault = faultLine(high);
  const fix = (): void => {
    const range: [number, number] = [low.valueAsNumber, high.valueAsNumber];
    const isRight = judge(high, fault, range[1] > range[0] ? "" : "the greatest must be above the least");
    if (isRight) actions.change({ ...spec, range });
  };
  const automatic = make("button", { type: "button", id: "scope-auto", "aria-pressed": String(!spec.range), onclick: () => actions.change({ ...spec, range: null }) }, "Automatic");
  const fixed = make("button", { type: "button", id: "scope-fix", "aria-pressed": String(Boolean(spec.range)), onclick: fix }, "Fixed");
  for (const input of [low, high]) input.addEventListener("change", () => low.value !== "" && high.value !== "" && fix());
  return make("div", {}, make("div", { class: "row tight" }, "Range", make("div", { class: "segments" }, automatic, fixed), low, "to", high, unit), fault);
}

function curvesOf(store: Store, spec: ScopeSpec, actions: SheetActions, fault: HTMLElement): HTMLElement[] {
  const name = (ref: CurveRef): string => `${ref.stream}.${ref.column}`;
  const chosen = new Set(spec.curves.map(name));
  return catalog(store).map(({ stream, topic, curves }) => {
    const boxes = curves.map((ref) => {
      const { unit } = drawnAs(store, ref);
      const box = make("input", { type: "checkbox", checked: chosen.has(name(ref)) });
      box.addEventListener("change", () => {
        const next = box.checked ? [...spec.curves, ref] : spec.curves.filter((curve) => name(curve) !== name(ref));
        const units = new Set(next.map((curve) => drawnAs(store, curve).unit));
        const words = units.size > 2 ? "a scope has two axes: not more than two units" : next.length > MOST_CURVES ? `a scope has ${MOST_CURVES} curves at most` : next.length ? "" : "a scope has one curve at least";
        fault.textContent = words;
        if (words) box.checked = !box.checked;
        else actions.change({ ...spec, curves: next });
      });
      return make("label", {}, box, `${ref.column.replaceAll("_", " ")}${unit ? `, ${unit}` : ""}`);
    });
    return make("fieldset", {}, make("legend", {}, `${stream.replace("_", " ")} · ${topic}`), make("div", { class: "choices" }, ...boxes));
  });
}
