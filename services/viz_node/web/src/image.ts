import type { Commands } from "./commands";
import { save } from "./dom";
import { Form } from "./form";
import { simpleField } from "./gsf";
import { LEVELLINGS } from "./levelling";
import { programName } from "./programs";
import { programsOf, settings } from "./schema";
import type { Store } from "./store";
import { Surface } from "./surface";
import { INSTRUMENT } from "./tip";

const METRE = 1e-9;

/** The image that is on the page: the programs of the instrument that make one, its surface, and its files. */
export class Image {
  readonly surface = new Surface();
  /** The settings of each program of the instrument, as they were typed. */
  forms = new Map<string, { title: string; form: Form }>();

  /** Called when the heights are to be seen in another way. */
  onLook: () => void = () => {};
  /** Gives the image as a picture; none where there is no scene. */
  onPicture: () => HTMLCanvasElement | undefined = () => undefined;
  /** Draws over the image from above: `at` gives the place on the canvas of one on the sample [nm], `scale` pixels for a nm. */
  onDraw: (pen: CanvasRenderingContext2D, at: (x: number, y: number) => [number, number], scale: number) => void = () => {};
  /** Returns what moves with the pointer that was pressed at a place of the image from above [nm]; nothing where that is free. */
  onGrab: (x: number, y: number) => ((x: number, y: number) => void) | undefined = () => undefined;
  /** Does what comes next with the particles of the image, for who has one button; `nextText` says what. */
  onNext: () => void = () => {};
  nextText: () => string = () => "";
  /** Called when what is drawn over the image has changed. */
  redraw: () => void = () => {};

  constructor(
    private readonly commands: Commands,
    private readonly store: Store,
  ) {}

  /** Build the forms of what the instrument of this rig can do by itself. */
  build(): void {
    const schema = (this.store.forms[INSTRUMENT] ?? {}) as Record<string, unknown>;
    this.forms = new Map(programsOf(schema).map(({ name, title }) => [name, { title, form: new Form(settings(schema, name, "instrument"), "program") }]));
  }

  /** Begin a program with what was typed for it; refused in words where something there cannot be. */
  async begin(program: string): Promise<void> {
    const values = this.forms.get(program)?.form.values();
    if (values) await this.commands.command(`${programName(program)} begins`, "set", INSTRUMENT, { program, ...values });
    else this.commands.show(`${programName(program)} begins`, false, "one of its settings is not valid: the tab Image shows which");
  }

  /** Save the heights as they are shown, for Gwyddion. */
  saveGsf(): void {
    save("telenano-image.gsf", new Blob([this.gsf()], { type: "application/octet-stream" }));
  }

  /** The bytes of that file. */
  gsf(): Uint8Array<ArrayBuffer> {
    const { extent, levelling } = this.surface;
    if (!extent) throw new Error("there is no image to save");
    const { measured, shown, rows, columns } = this.surface.grid();
    const lines = Array.from({ length: rows }, (_, row) => row).filter((row) => !Number.isNaN(measured[row * columns]!));
    const isWhole = lines.length === rows;
    const partial = `${lines.length} of ${rows} lines`;
    const about = {
      XReal: extent.width * METRE,
      YReal: ((extent.depth * (lines.length - 1)) / Math.max(1, rows - 1)) * METRE,
      Title: `Height${levelling === "none" ? "" : ` less ${LEVELLINGS[levelling]}`}${isWhole ? "" : ` (partial: ${partial})`}`,
      Source: this.store.source.name,
      Program: "telenano",
      ...(isWhole ? {} : { Partial: partial }),
    };
    const heights = levelling === "none" ? measured : shown;
    return simpleField(about, lines.map((row) => heights.subarray(row * columns, (row + 1) * columns).map((height) => height * METRE)));
  }
}
