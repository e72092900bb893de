/** A channel of an image: title, unit, values of shape (rows, columns) with y rising, in SI units, and its sides [m]. */
export interface Channel {
  title: string;
  unit: string;
  values: ArrayLike<number>;
  rows: number;
  columns: number;
  width_m: number;
  depth_m: number;
}

/** A value with the letter of its type, as the format of Gwyddion's native files has them. */
type Item = [type: "i" | "d" | "s" | "b", value: number | string] | ["D", ArrayLike<number>] | ["o", Thing];
interface Thing {
  name: string;
  items: [key: string, item: Item][];
}

const TEXT = new TextEncoder();

/** A file of Gwyddion (.gwy): the letters GWYP and a container, little-endian, texts that end with a zero. */
export function gwyFile(channels: readonly Channel[], about: Readonly<Record<string, string>> = {}): Uint8Array<ArrayBuffer> {
  const items = channels.flatMap((channel, number): [string, Item][] => [
    [`/${number}/data`, ["o", field(channel)]],
    [`/${number}/data/title`, ["s", channel.title]],
    [`/${number}/meta`, ["o", { name: "GwyContainer", items: Object.entries(about).map(([key, value]) => [key, ["s", value]]) }]],
  ]);
  return joined([TEXT.encode("GWYP"), packed({ name: "GwyContainer", items })]);
}

function field({ values, unit, rows, columns, width_m, depth_m }: Channel): Thing {
  // the first row of a file is the top of the picture
  const turned = Float64Array.from({ length: rows * columns }, (_, i) => values[(rows - 1 - Math.floor(i / columns)) * columns + (i % columns)]!);
  const unitOf = (text: string): Item => ["o", { name: "GwySIUnit", items: [["unitstr", ["s", text]]] }];
  return {
    name: "GwyDataField",
    items: [
      ["xres", ["i", columns]],
      ["yres", ["i", rows]],
      ["xreal", ["d", width_m]],
      ["yreal", ["d", depth_m]],
      ["si_unit_xy", unitOf("m")],
      ["si_unit_z", unitOf(unit)],
      ["data", ["D", turned]],
    ],
  };
}

function packed(thing: Thing): Uint8Array<ArrayBuffer> {
  const body = joined(thing.items.flatMap(([key, item]) => [ended(key), TEXT.encode(item[0]), valueOf(item)]));
  return joined([ended(thing.name), words(4, (view) => view.setUint32(0, body.length, true)), body]);
}

function valueOf(item: Item): Uint8Array<ArrayBuffer> {
  const [type, value] = item;
  if (type === "o") return packed(value);
  if (type === "D") {
    return words(4 + 8 * value.length, (view) => {
      view.setUint32(0, value.length, true);
      for (let i = 0; i < value.length; i++) view.setFloat64(4 + 8 * i, value[i]!, true);
    });
  }
  if (type === "s") return ended(String(value));
  if (type === "d") return words(8, (view) => view.setFloat64(0, Number(value), true));
  if (type === "b") return new Uint8Array([Number(value)]);
  return words(4, (view) => view.setInt32(0, Number(value), true));
}

function ended(text: string): Uint8Array<ArrayBuffer> {
  return TEXT.encode(`${text}\0`) as Uint8Array<ArrayBuffer>;
}

function words(size: number, write: (view: DataView) => void): Uint8Array<ArrayBuffer> {
  const buffer = new ArrayBuffer(size);
  write(new DataView(buffer));
  return new Uint8Array(buffer);
}

function joined(parts: readonly Uint8Array[]): Uint8Array<ArrayBuffer> {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}
