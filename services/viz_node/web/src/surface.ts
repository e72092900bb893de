import { BufferAttribute, BufferGeometry, Color, DoubleSide, Mesh, MeshStandardMaterial, SRGBColorSpace } from "three";
import { colourOf, type Palette } from "./colormap";
import { levelled, type Levelling } from "./levelling";
import { numbers, type Line } from "./protocol";

const NM = 1e9;
/** Colours are made again when the range of heights has grown by this share. */
const RECOLOUR = 0.02;
const MOST_POINTS = 1024;
const LINEAR = new Color();

/** A place in nm: x, y, z. */
export type Place = [number, number, number];

export interface Profile {
  distance: number[];
  height: number[];
}

/** The surface as a height field that grows line by line; lengths in nm, colours by height. */
export class Surface {
  readonly mesh: Mesh<BufferGeometry, MeshStandardMaterial>;
  least = 0;
  greatest = 0;
  /** Vertices uploaded for the last line: only what changed goes to the graphics processor. */
  uploaded = 0;
  /** How the heights are shown: what is taken off them, in which colours, and from which share of them to which. */
  palette: Palette = "viridis";
  levelling: Levelling = "none";
  /** Shares of the heights that the colours leave out at either end. */
  clipped = 0;
  /** Height that is shown as 0 [nm]. */
  base = 0;
  /** Heights at the ends of the colours [nm]. */
  range: [number, number] = [0, 0];
  lines = 0;
  points = 0;
  private filled: boolean[] = [];
  private coloured: [number, number] = [Infinity, -Infinity];
  /** As measured [nm]. */
  private heights = new Float32Array(0);
  /** As shown [nm]: the very same where nothing is taken off. */
  private shown = new Float32Array(0);

  constructor() {
    const material = new MeshStandardMaterial({ vertexColors: true, flatShading: true, side: DoubleSide, roughness: 0.75 });
    this.mesh = new Mesh(new BufferGeometry(), material);
    this.mesh.visible = false;
  }

  get isEmpty(): boolean {
    return !this.mesh.visible;
  }

  clear(): void {
    this.mesh.visible = false;
    this.lines = 0;
    this.points = 0;
  }

  /** Put a line of the trace in its place; the retrace is the same surface, measured again. */
  add(line: Line): void {
    const heights = numbers(line.height);
    const points = Math.min(MOST_POINTS, heights.length);
    if (line.direction !== "trace" || points < 2 || line.line >= line.lines || line.lines < 2) return;
    if (line.lines !== this.lines || points !== this.points) this.begin(Math.min(line.lines, MOST_POINTS), points);
    if (line.line >= this.lines) return;
    if (line.line === 0 && this.filled[this.lines - 1]) this.filled.fill(false);
    const position = this.mesh.geometry.getAttribute("position") as BufferAttribute;
    const [x0, y0] = [line.start_m[0] * NM, line.start_m[1] * NM];
    const [x1, y1] = [line.end_m[0] * NM, line.end_m[1] * NM];
    const first = line.line * points;
    for (let i = 0; i < points; i++) {
      const share = i / (points - 1);
      const z = (heights[i] as number) * NM;
      this.heights[first + i] = z;
      this.shown[first + i] = z;
      position.setXYZ(first + i, x0 + share * (x1 - x0), y0 + share * (y1 - y0), z);
    }
    this.filled[line.line] = true;
    this.uploaded = points;
    position.addUpdateRange(first * 3, points * 3);
    position.needsUpdate = true;
    if (this.levelling === "none" && this.clipped === 0) this.colour(line.line);
    else {
      this.measure(line.line);
      this.look();
    }
    this.join(line.line);
    this.mesh.visible = this.filled.filter(Boolean).length > 1;
    this.mesh.geometry.boundingSphere = null;
    this.mesh.geometry.boundingBox = null;
  }

  /** Height at a place of the plane [nm]: that of the nearest measured point; 0 where nothing was measured. */
  heightAt(x: number, y: number): number {
    if (this.isEmpty) return 0;
    const position = this.mesh.geometry.getAttribute("position") as BufferAttribute;
    let [nearest, found] = [Infinity, 0];
    for (let row = 0; row < this.lines; row++) {
      if (!this.filled[row]) continue;
      const first = row * this.points;
      const [x0, x1] = [position.getX(first), position.getX(first + this.points - 1)];
      const share = Math.min(1, Math.max(0, (x - x0) / (x1 - x0 || 1)));
      const place = first + Math.round(share * (this.points - 1));
      const distance = (position.getX(place) - x) ** 2 + (position.getY(place) - y) ** 2;
      if (distance < nearest) [nearest, found] = [distance, this.shown[place] as number];
    }
    return found;
  }

  /** The measured point nearest to a place [nm], with the numbers of its line and of itself; none without an image. */
  nearest(x: number, y: number): { at: Place; line: number; point: number; shown: number } | undefined {
    const found = this.isEmpty ? undefined : this.coordinates(x, y);
    if (!found) return undefined;
    const within = (value: number, count: number): number => Math.min(count - 1, Math.max(0, Math.round(value)));
    const [line, point] = [within(found.row, this.lines), within(found.column, this.points)];
    return this.filled[line] ? { at: this.place(line, point), line, point, shown: this.shown[line * this.points + point]! } : undefined;
  }

  /**
   * Heights along a straight line between two places [nm], between the measured points by both axes in proportion;
   * NaN where nothing was measured.
   */
  profile(from: readonly [number, number], to: readonly [number, number], count: number): Profile {
    const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
    const shares = Array.from({ length: count }, (_, i) => i / (count - 1));
    return {
      distance: shares.map((share) => share * length),
      height: shares.map((share) => this.between(from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]))),
    };
  }

  /** Middle and sides of the whole image [nm], also while only some of its lines are there. */
  get extent(): { x: number; y: number; width: number; depth: number } | undefined {
    const rows = this.filled.flatMap((filled, row) => (filled ? [row] : []));
    if (this.isEmpty || rows.length < 2) return undefined;
    const [first, last] = [rows[0]!, rows.at(-1)!];
    const [a, b, c] = [this.place(first, 0), this.place(first, this.points - 1), this.place(last, 0)];
    const step = [(c[0] - a[0]) / (last - first), (c[1] - a[1]) / (last - first)] as const;
    const middle = (this.lines - 1) / 2 - first;
    return {
      x: (a[0] + b[0]) / 2 + middle * step[0],
      y: (a[1] + b[1]) / 2 + middle * step[1],
      width: Math.hypot(b[0] - a[0], b[1] - a[1]),
      depth: Math.hypot(...step) * (this.lines - 1),
    };
  }

  private place(line: number, point: number): Place {
    const position = this.mesh.geometry.getAttribute("position") as BufferAttribute;
    const i = line * this.points + point;
    return [position.getX(i), position.getY(i), this.heights[i] as number];
  }

  /** A place [nm] in numbers of lines and points, with fractions: the lines of an image are parallel, in equal steps. */
  private coordinates(x: number, y: number): { row: number; column: number } | undefined {
    const rows = this.filled.flatMap((filled, row) => (filled ? [row] : []));
    const [first, last] = [rows[0], rows.at(-1)];
    if (first === undefined || last === undefined || first === last) return undefined;
    const [origin, end, next] = [this.place(first, 0), this.place(first, this.points - 1), this.place(last, 0)];
    const along = [(end[0] - origin[0]) / (this.points - 1), (end[1] - origin[1]) / (this.points - 1)] as const;
    const across = [(next[0] - origin[0]) / (last - first), (next[1] - origin[1]) / (last - first)] as const;
    const area = along[0] * across[1] - along[1] * across[0];
    if (area === 0) return undefined;
    const [dx, dy] = [x - origin[0], y - origin[1]];
    return { column: (dx * across[1] - dy * across[0]) / area, row: first + (along[0] * dy - along[1] * dx) / area };
  }

  private between(x: number, y: number): number {
    const found = this.isEmpty ? undefined : this.coordinates(x, y);
    if (!found) return NaN;
    // the last line and the last point belong to the image
    const rounding = 1e-6;
    const [row, column] = [found.row, found.column].map((value) => (Math.abs(value - Math.round(value)) < rounding ? Math.round(value) : value)) as [number, number];
    const [low, left] = [Math.floor(row), Math.floor(column)];
    const [high, right] = [Math.ceil(row), Math.ceil(column)];
    if (!this.filled[low] || !this.filled[high] || left < 0 || right >= this.points) return NaN;
    const mean = (line: number): number => {
      const [a, b] = [this.shown[line * this.points + left]!, this.shown[line * this.points + right]!];
      return a + (b - a) * (column - left);
    };
    return mean(low) + (mean(high) - mean(low)) * (row - low);
  }

  private begin(lines: number, points: number): void {
    this.lines = lines;
    this.points = points;
    this.filled = new Array<boolean>(lines).fill(false);
    this.heights = new Float32Array(lines * points);
    this.shown = new Float32Array(lines * points);
    this.coloured = [Infinity, -Infinity];
    [this.least, this.greatest] = [Infinity, -Infinity];
    this.mesh.geometry.dispose();
    this.mesh.geometry = new BufferGeometry();
    this.mesh.geometry.setAttribute("position", new BufferAttribute(new Float32Array(lines * points * 3), 3));
    this.mesh.geometry.setAttribute("color", new BufferAttribute(new Float32Array(lines * points * 3), 3));
    this.mesh.geometry.setIndex(new BufferAttribute(new Uint32Array((lines - 1) * (points - 1) * 6), 1));
    this.mesh.geometry.setDrawRange(0, 0);
  }

  /** Show all heights as they are to be seen now: after another levelling, palette or range. */
  look(): void {
    if (!this.lines) return;
    this.shown = levelled(this.heights, this.filled, this.points, this.levelling);
    const position = this.mesh.geometry.getAttribute("position") as BufferAttribute;
    for (let i = 0; i < this.shown.length; i++) position.setZ(i, this.shown[i]!);
    position.clearUpdateRanges();
    position.needsUpdate = true;
    const known = this.filled.flatMap((filled, row) => (filled ? [...this.shown.subarray(row * this.points, (row + 1) * this.points)] : []));
    known.sort((a, b) => a - b);
    if (!known.length) return;
    const at = (share: number): number => known[Math.round(share * (known.length - 1))]!;
    this.base = known[0]!;
    this.range = [at(this.clipped), at(1 - this.clipped)];
    this.coloured = [...this.range];
    this.paint(this.filled.flatMap((filled, row) => (filled ? [row] : [])));
    this.mesh.geometry.boundingSphere = null;
    this.mesh.geometry.boundingBox = null;
  }

  /** Heights as measured and as shown [nm], of shape (lines, points), lines with y rising; NaN where nothing was measured. */
  grid(): { measured: Float32Array; shown: Float32Array; rows: number; columns: number } {
    const only = (values: Float32Array): Float32Array => values.map((value, i) => (this.filled[Math.floor(i / this.points)] ? value : NaN));
    return { measured: only(this.heights), shown: only(this.shown), rows: this.lines, columns: this.points };
  }

  /** How many of the lines were measured. */
  get measuredLines(): number {
    return this.filled.filter(Boolean).length;
  }

  private measure(row: number): void {
    for (let i = row * this.points; i < (row + 1) * this.points; i++) {
      this.least = Math.min(this.least, this.heights[i] as number);
      this.greatest = Math.max(this.greatest, this.heights[i] as number);
    }
  }

  private colour(row: number): void {
    this.measure(row);
    [this.base, this.range] = [this.least, [this.least, this.greatest]];
    const margin = RECOLOUR * (this.coloured[1] - this.coloured[0]);
    const grown = this.least < this.coloured[0] - margin || this.greatest > this.coloured[1] + margin;
    if (grown) this.coloured = [this.least, this.greatest];
    this.paint(grown ? this.filled.flatMap((filled, r) => (filled ? [r] : [])) : [row]);
  }

  private paint(rows: number[]): void {
    const colours = this.mesh.geometry.getAttribute("color") as BufferAttribute;
    const range = this.coloured[1] - this.coloured[0] || 1;
    for (const r of rows) {
      for (let i = r * this.points; i < (r + 1) * this.points; i++) {
        // the library computes with linear light
        LINEAR.setRGB(...colourOf(this.palette, ((this.shown[i] as number) - this.coloured[0]) / range), SRGBColorSpace);
        colours.setXYZ(i, LINEAR.r, LINEAR.g, LINEAR.b);
      }
      colours.addUpdateRange(r * this.points * 3, this.points * 3);
    }
    colours.needsUpdate = true;
  }

  /** Join a line to those beside it; where one is missing the triangles are degenerate, and nothing is drawn. */
  private join(row: number): void {
    const index = this.mesh.geometry.getIndex() as BufferAttribute;
    const size = (this.points - 1) * 6;
    for (const lower of [row - 1, row]) {
      if (!this.filled[lower] || !this.filled[lower + 1]) continue;
      for (let i = 0; i + 1 < this.points; i++) {
        const a = lower * this.points + i;
        const b = a + this.points;
        index.array.set([a, a + 1, b, a + 1, b + 1, b], lower * size + i * 6);
      }
      index.addUpdateRange(lower * size, size);
    }
    index.needsUpdate = true;
    this.mesh.geometry.setDrawRange(0, index.count);
  }
}
