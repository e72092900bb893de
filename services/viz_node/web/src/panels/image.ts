import type { Cockpit, Panel } from "../cockpit";
import { PALETTES, type Palette } from "../colormap";
import { make, save } from "../dom";
import { LEVELLINGS, type Levelling } from "../levelling";

const RANGES: readonly (readonly [number, string])[] = [
  [0, "whole range"],
  [0.01, "1 to 99 %"],
  [0.05, "5 to 95 %"],
];

/** How the image is shown and saved, and with which gains and set-points the next one is taken. */
export class ImagePanel implements Panel {
  private readonly about = make("p", { class: "quiet" });
  private readonly forms = make("div");
  private readonly saves: HTMLButtonElement[];

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const { surface } = cockpit.image;
    const choice = (id: string, label: string, options: readonly (readonly [string, string])[], change: (value: string) => void): HTMLSelectElement => {
      const select = make("select", { id, "aria-label": label, onchange: () => this.change(() => change(select.value)) }, ...options.map(([value, text]) => make("option", { value }, text)));
      return select;
    };
    const levelling = choice("levelling", "Levelling", Object.entries(LEVELLINGS), (value) => (surface.levelling = value as Levelling));
    const palette = choice("palette", "Palette", Object.keys(PALETTES).map((name) => [name, name] as const), (value) => (surface.palette = value as Palette));
    const range = choice("range", "Range of the colours", RANGES.map(([share, text]) => [String(share), text] as const), (value) => (surface.clipped = Number(value)));
    const button = (id: string, text: string, action: () => void): HTMLButtonElement => make("button", { type: "button", id, disabled: true, onclick: action }, text);
    this.saves = [
      button("save-gsf", "Save .gsf", () => cockpit.image.saveGsf()),
      button("save-image", "Save PNG", () => cockpit.image.onPicture()?.toBlob((blob) => blob && save("telenano-image.png", blob))),
    ];
    root.append(make("div", { class: "row" }, levelling, palette, range), this.about, make("div", { class: "row" }, ...this.saves), this.forms);
  }

  begin(): void {
    const { image } = this.cockpit;
    const rows = [...image.forms.entries()].map(([name, { title, form }]) => make("details", { open: name === "scan" }, make("summary", {}, `Next ${title.toLowerCase()}`), form.element));
    this.forms.replaceChildren(...rows);
    this.write();
  }

  write(): void {
    const { surface } = this.cockpit.image;
    for (const button of this.saves) button.disabled = surface.isEmpty;
    const extent = surface.extent;
    const text = extent
      ? `${surface.points} × ${surface.lines} points, ${+extent.width.toPrecision(3)} × ${+extent.depth.toPrecision(3)} nm, ${surface.measuredLines} lines measured. Heights from 0 to ${+(surface.range[1] - surface.base).toPrecision(3)} nm. Drag over the flat image for a profile.`
      : "No image yet. The button Image takes one; Both and Flat in the scene show it from above.";
    if (this.about.textContent !== text) this.about.textContent = text;
  }

  private change(set: () => void): void {
    set();
    this.cockpit.image.surface.look();
    this.cockpit.image.onLook();
    this.write();
  }
}
