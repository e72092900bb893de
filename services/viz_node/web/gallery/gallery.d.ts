/** What `telenano study gallery` writes; gallery.js draws it. */
export type GalleryData = { delays_ms: number[] } & Record<string, unknown>;

export function values(differences: number[], unit: number): number[];
export function ticks(range: [number, number]): number[];
export function nearest(delays: number[], delay: number): number;

export class Gallery {
  constructor(root: HTMLElement, data: GalleryData);
  readonly delayMs: number;
  choose(law: string, delayMs: number): void;
}
