import { make } from "./dom";

/** What is wrong with a number that was typed, in words; empty where nothing is. */
export function faultOf(text: string, min: number | undefined, max: number | undefined, unit: string, whole = false): string {
  if (text.trim() === "") return "";
  const value = Number(text);
  const suffix = unit ? ` ${unit}` : "";
  if (!Number.isFinite(value)) return `${text} is not a number`;
  if (whole && !Number.isInteger(value)) return "must be a whole number";
  if (min !== undefined && max !== undefined && (value < min || value > max)) return `must be from ${compact(min)} to ${compact(max)}${suffix}`;
  if (min !== undefined && value < min) return `must be at least ${compact(min)}${suffix}`;
  if (max !== undefined && value > max) return `must be at most ${compact(max)}${suffix}`;
  return "";
}

/** A number as short as it can be written without losing what matters. */
export function compact(value: number): string {
  const rounded = +value.toPrecision(6);
  const plain = `${rounded}`;
  const short = rounded.toExponential().replace("e+", "e");
  return plain.length > 6 && short.length < plain.length ? short : plain;
}

/** Say at a field what is wrong with what was typed there; returns whether nothing is. */
export function judge(input: HTMLInputElement, fault: HTMLElement, text: string): boolean {
  fault.textContent = text;
  if (text) input.setAttribute("aria-invalid", "true");
  else input.removeAttribute("aria-invalid");
  return !text;
}

/** Where a field says what is wrong with it, tied to it for screen readers. */
export function faultLine(input: HTMLInputElement): HTMLElement {
  const line = make("div", { class: "fault", id: `${input.id}-fault`, role: "alert" });
  input.setAttribute("aria-describedby", line.id);
  return line;
}
