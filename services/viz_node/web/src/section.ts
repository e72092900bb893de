import { BufferGeometry, Float32BufferAttribute, Line as Polyline, LineBasicMaterial } from "three";
import uPlot from "uplot";
import { colour, make, save } from "./dom";
import type { Profile, Surface } from "./surface";

type Spot = readonly [number, number];

const SAMPLES = 256;
/** The line lies above the surface by this share of its length, or the surface would hide it. */
const ABOVE = 0.004;

/** A straight line on the surface and the heights along it: drawn in the scene, and as a curve beside it. */
export class Section {
  readonly polyline = new Polyline(new BufferGeometry(), new LineBasicMaterial({ color: 0xff2fb3, depthTest: false }));
  readonly element: HTMLElement;
  profile: Profile | undefined;
  onChange: () => void = () => {};
  private readonly area = make("div", { class: "area" });
  private readonly text = make("span", { id: "section-text" });
  private ends: [Spot, Spot] | undefined;
  private plot: uPlot | undefined;

  constructor(private readonly surface: Surface) {
    this.polyline.visible = false;
    this.polyline.renderOrder = 2;
    const keep = make("button", { type: "button", id: "section-csv", "aria-label": "Save the section as CSV", onclick: () => this.save() }, "CSV");
    this.element = make("div", { class: "profile", role: "group", "aria-label": "Section of the surface", hidden: true });
    const close = make("button", { type: "button", class: "icon", "aria-label": "Close the profile", onclick: () => this.setOn(false) }, "×");
    this.element.append(make("div", { class: "row" }, this.text, make("span", { class: "spacer" }), keep, close), this.area);
  }

  isOn = false;

  setOn(isOn: boolean): void {
    this.isOn = isOn;
    this.draw();
    this.onChange();
  }

  /** The ends of the line [nm]; none while it is not shown. */
  get line(): [Spot, Spot] | undefined {
    return this.isOn ? this.ends : undefined;
  }

  /** Draw the line from one place to another [nm]. */
  set(from: Spot, to: Spot): void {
    this.ends = [from, to];
    this.draw();
  }

  /** Show the heights as they are now: the surface has grown, or the theme has changed. */
  draw(): void {
    const shown = this.isOn && !this.surface.isEmpty;
    if (shown && !this.ends) this.ends = this.across();
    this.polyline.visible = shown && this.ends !== undefined;
    this.element.hidden = !this.polyline.visible;
    if (!shown || !this.ends) return;
    const [from, to] = this.ends;
    const profile = this.surface.profile(from, to, SAMPLES);
    this.profile = profile;
    const length = profile.distance.at(-1)!;
    const points = profile.height.flatMap((height, i) => {
      const share = i / (SAMPLES - 1);
      return [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]), (Number.isNaN(height) ? this.surface.base : height) + ABOVE * length];
    });
    this.polyline.geometry.setAttribute("position", new Float32BufferAttribute(points, 3));
    this.polyline.geometry.computeBoundingSphere();
    const known = profile.height.filter((height) => !Number.isNaN(height));
    const depth = known.length ? `, height range ${(Math.max(...known) - Math.min(...known)).toPrecision(4)} nm` : "";
    this.text.textContent = `${length.toPrecision(4)} nm${depth}`;
    const data: uPlot.AlignedData = [profile.distance, profile.height.map((height) => (Number.isNaN(height) ? null : height - this.surface.base))];
    if (!this.plot) this.plot = this.build(data);
    else this.plot.setData(data);
    this.onChange();
  }

  clear(): void {
    this.ends = undefined;
    this.draw();
  }

  recolour(): void {
    this.plot?.destroy();
    this.plot = undefined;
    this.draw();
  }

  /** Along the lines, through the middle of what was measured. */
  private across(): [Spot, Spot] | undefined {
    const extent = this.surface.extent;
    return extent && [
      [extent.x - extent.width / 2, extent.y],
      [extent.x + extent.width / 2, extent.y],
    ];
  }

  private build(data: uPlot.AlignedData): uPlot {
    const axis = { stroke: colour("quiet"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    const labels = (_: uPlot, splits: number[]): string[] => splits.map((value) => `${+value.toPrecision(4)}`);
    return new uPlot(
      {
        width: 270,
        height: 118,
        legend: { show: false },
        cursor: { drag: { x: false, y: false } },
        scales: { x: { time: false } },
        axes: [
          { ...axis, size: 34, label: "along the section, nm", labelSize: 14, labelFont: "11px system-ui", values: labels },
          { ...axis, size: 44, space: 18, label: "height, nm", labelSize: 14, labelFont: "11px system-ui", values: labels },
        ],
        series: [{}, { stroke: colour("sample"), width: 1.5, points: { show: false } }],
      },
      data,
      this.area,
    );
  }

  private save(): void {
    if (!this.profile) return;
    const rows = this.profile.distance.map((distance, i) => `${distance * 1e-9},${this.profile!.height[i]! * 1e-9}`);
    save("telenano-section.csv", new Blob([`distance_m,height_m\n${rows.join("\n")}\n`], { type: "text/csv" }));
  }
}
