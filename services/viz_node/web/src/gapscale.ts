import { fixed } from "./numbers";

/** Below this the scale of the gap is even, above it each factor of ten has the same height [nm]. */
export const EVEN_NM = 0.1;
/** What the picture of the gap shows: so far into the sample, and so far above it [nm]. */
export const DEEPEST_NM = 10;
export const HIGHEST_NM = 100;
/** Distances that are named beside the scale [nm]. */
export const GAP_TICKS: readonly number[] = [100, 10, 1, 0.1, 0, -1, -10];
/** A force of this size and more has the longest arrow where no limit is known, and one of this size or less none [nN]. */
const LONGEST_NN = 100;
const LEAST_NN = 0.05;
/** A tip that moves more slowly than this rests, as far as an eye can tell [nm/s]. */
const RESTING_NM_PER_S = 0.3;

/** A distance on a scale that is even near 0 and logarithmic beyond, for both signs: 0 at the surface. */
export function symlog(nm: number): number {
  return Math.asinh(nm / (2 * EVEN_NM));
}

/** Where a distance is in the picture: 0 at its lower edge, 1 at its upper one; what lies beyond stays at the edge. */
export function gapShare(nm: number): number {
  const [low, high] = [symlog(-DEEPEST_NM), symlog(HIGHEST_NM)];
  return Math.min(1, Math.max(0, (symlog(nm) - low) / (high - low)));
}

/** The length of the arrow of a force, from -1 (pulls down) to 1 (pushes up, at the limit), each factor of ten by the same length. */
export function arrowShare(nn: number, limit_nn = NaN): number {
  if (!(Math.abs(nn) >= LEAST_NN)) return 0;
  const share = Math.log10(Math.abs(nn) / LEAST_NN) / Math.log10((limit_nn > LEAST_NN ? limit_nn : LONGEST_NN) / LEAST_NN);
  return Math.sign(nn) * Math.min(1, Math.max(0.12, share));
}

/** The limit of the guard in words, in nN; empty where none is known. */
export function limitWords(limit_nn: number): string {
  return limit_nn > 0 && Number.isFinite(limit_nn) ? `limit ${Number(limit_nn.toPrecision(3))} nN` : "";
}

/** What the picture of the gap says in words: distance, force, and speed. Distances in nm, force in nN, speed in nm/s. */
export function gapWords(separation_nm: number, force_nn: number, speed_nm_per_s: number, touches: boolean, meniscus: boolean): { gap: string; force: string; speed: string } {
  const away = Math.abs(separation_nm);
  const size = away < 9.95 ? fixed(away, 1) : fixed(away, 0);
  const beyond = away > HIGHEST_NM ? ", off this scale" : "";
  let gap = Number.isNaN(separation_nm) ? "distance not known" : `${size} nm above the sample${beyond}`;
  if (touches) gap = Number.isNaN(separation_nm) || separation_nm >= -0.05 ? "touches the sample" : `${size} nm into the sample`;
  else if (meniscus) gap = Number.isNaN(separation_nm) ? "held by a water bridge" : `${size} nm above, held by a water bridge`;
  const isFelt = Math.abs(force_nn) >= LEAST_NN;
  const nn = Math.abs(force_nn) < 9.95 ? fixed(Math.abs(force_nn), 1) : fixed(Math.abs(force_nn), 0);
  const speed = Math.abs(speed_nm_per_s);
  return {
    gap,
    force: !isFelt ? "no force" : force_nn > 0 ? `${nn} nN, the sample pushes` : `${nn} nN, the sample pulls`,
    speed: !(speed >= RESTING_NM_PER_S) ? "rests" : `${speed < 9.95 ? fixed(speed, 1) : fixed(speed, 0)} nm/s ${speed_nm_per_s < 0 ? "towards the sample" : "away from it"}`,
  };
}
