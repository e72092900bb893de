/** From this time between frames on the machine is slow at drawing, as one without a graphics processor is [ms]. */
const SLOW_MS = 45;
const LONGEST_MS = 1000;

/** How often something is drawn that is dear to draw: in each frame, and where frames are slow in one of several. */
export class Pace {
  /** Time between frames, smoothed [ms]. */
  private period = 16;
  private frameAt: number | undefined;
  private drawnAt = -Infinity;

  /** `share`: where frames are slow, this many of their periods pass between two pictures. */
  constructor(private readonly share: number) {}

  /** Take note of a frame [ms], and return whether what is dear may be drawn in it. */
  isDue(now: number): boolean {
    this.period += 0.2 * (Math.min(LONGEST_MS, now - (this.frameAt ?? now - this.period)) - this.period);
    this.frameAt = now;
    return this.period <= SLOW_MS || now - this.drawnAt >= this.share * this.period;
  }

  /** Take note that it was drawn. */
  drawn(now: number): void {
    this.drawnAt = now;
  }
}

/** Whether WebGL is drawn by the processor, for which each pixel is dear. */
export function drawsInSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = String((names && gl?.getParameter(names.UNMASKED_RENDERER_WEBGL)) ?? "");
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}
