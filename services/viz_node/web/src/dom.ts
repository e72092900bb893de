type Child = Node | string;

/** Make an element; attributes that are `false` are left out, handlers begin with `on`. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string | boolean | number | ((event: never) => void)> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value as EventListener);
    else if (value !== false) element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children);
  return element;
}

export function part(id: string): HTMLElement {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found;
}

/** The value of a colour of the theme. */
export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** A number with its unit in the prefix that suits it. */
export function quantity(value: number, unit: string, digits = 3): string {
  if (!Number.isFinite(value)) return "–";
  const steps: [number, string][] = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"]];
  const size = Math.abs(value);
  const [factor, prefix] = size === 0 ? [1, ""] : (steps.find(([step]) => size >= step) ?? steps.at(-1)!);
  return `${(value / factor).toPrecision(digits)} ${prefix}${unit}`;
}

export function save(name: string, data: Blob): void {
  const url = URL.createObjectURL(data);
  make("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
