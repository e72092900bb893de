import { pack, read, type DatagramsFrame, type ServerFrame } from "./protocol";

/** How often the page asks whether datagrams come through, both ways [ms]. */
const PROBE_MS = 100;
/** Without a datagram for this long the way is taken for blocked, and the web socket carries everything [ms]. */
const HEARD_MS = 500;
/** A datagram that has waited for so long counts no more [ms]. */
const OLD_MS = 50;
const LARGEST_BYTES = 512;

/** The datagrams of a page beside its web socket, where what serves it has them: the newest counts, and a lost one is lost. */
export class Datagrams {
  private session: WebTransport | undefined;
  private writer: WritableStreamDefaultWriter<BufferSource> | undefined;
  private heardAt = -Infinity;
  private timer: ReturnType<typeof setInterval> | undefined;

  /** `take` gets what comes, other than answers to probes. */
  constructor(private readonly take: (frame: ServerFrame) => void) {}

  /** Open the session that an offer names, beside the socket at `url`. */
  async open(url: string, offer: DatagramsFrame): Promise<void> {
    this.close();
    if (typeof WebTransport === "undefined") return;
    const at = new URL(offer.path, url);
    at.protocol = "https:";
    const hashes = offer.hash.length ? { serverCertificateHashes: [{ algorithm: "sha-256", value: offer.hash.slice() }] } : {};
    const session = new WebTransport(at.href, hashes);
    this.session = session;
    session.closed.catch(() => {}).finally(() => this.session === session && this.close());
    try {
      await session.ready;
    } catch {
      return;
    }
    if (this.session !== session) return;
    // what waits for a line that is full is old: it is dropped here, and the next one goes
    session.datagrams.outgoingMaxAge = session.datagrams.incomingMaxAge = OLD_MS;
    this.writer = session.datagrams.writable.getWriter();
    this.timer = setInterval(() => this.write(pack({ k: "probe", stamp_s: performance.now() / 1e3 })), PROBE_MS);
    await this.listen(session).catch(() => {});
  }

  /** Whether datagrams have come through both ways just now. */
  get isOpen(): boolean {
    return performance.now() - this.heardAt < HEARD_MS;
  }

  /** Send a frame if datagrams come through, and return whether they do. */
  send(frame: Uint8Array<ArrayBuffer>): boolean {
    if (this.isOpen) this.write(frame);
    return this.isOpen;
  }

  close(): void {
    clearInterval(this.timer);
    this.heardAt = -Infinity;
    this.writer = undefined;
    const { session } = this;
    this.session = undefined;
    try {
      session?.close();
    } catch {
      // it never opened
    }
  }

  private write(frame: Uint8Array<ArrayBuffer>): void {
    const { writer } = this;
    if (writer && frame.length <= LARGEST_BYTES && (writer.desiredSize ?? 0) > 0) writer.write(frame).catch(() => {});
  }

  private async listen(session: WebTransport): Promise<void> {
    const reader = session.datagrams.readable.getReader() as ReadableStreamDefaultReader<Uint8Array<ArrayBuffer>>;
    for (let got = await reader.read(); !got.done; got = await reader.read()) {
      this.heardAt = performance.now();
      const frame = read(got.value.slice().buffer);
      if (frame.k !== "probe") this.take(frame);
    }
  }
}
