import type { Outcome } from "./answers";
import { PROTOCOL, pack, read, type Answer, type Facts, type ServerFrame } from "./protocol";
import type { Felt, FromSocket, ToSocket } from "./socket.worker";

const FIRST_RETRY_MS = 300;
const LONGEST_RETRY_MS = 3000;
/** The server sends thirty times a second while something changes, and answers within 5 s. */
const ANSWER_MS = 12_000;

/** What became of a request, and how long this page waited for it [s]. */
export interface Reply extends Answer {
  outcome: Outcome;
  waited_s: number;
}

export type LinkState = "connecting" | "open" | "lost" | "refused";

/** The connection of the page: it says hello, comes back by itself, and matches answers to requests. */
export class Connection {
  onFrame: (frame: ServerFrame) => void = () => {};
  onState: (state: LinkState, text: string) => void = () => {};
  onFelt: (felt: Felt) => void = () => {};
  private readonly worker = new Worker(new URL("./socket.worker.ts", import.meta.url), { type: "module" });
  private isOpen = false;
  private refusal = "";
  private retry = FIRST_RETRY_MS;
  private issued = 0;
  private readonly sender = crypto.getRandomValues(new Uint32Array(2)).join("");
  private readonly waiting = new Map<string, (answer: Answer, outcome: Outcome) => void>();

  constructor(
    private readonly url: string,
    private readonly token: string,
  ) {
    this.worker.onmessage = ({ data }: MessageEvent<FromSocket>) => {
      if (data.k === "frame") this.take(read(data.frame));
      else if (data.k === "felt") this.onFelt(data.felt);
      else if (data.k === "open") this.greet();
      else this.lose();
    };
    this.worker.onerror = () => this.onState("lost", "the page is incomplete: load it again");
  }

  open(): void {
    this.onState("connecting", "connecting to the server");
    this.refusal = "";
    this.tell({ open: this.url });
  }

  private greet(): void {
    this.isOpen = true;
    this.send({ k: "hello", token: this.token, protocol: PROTOCOL });
  }

  private take(frame: ServerFrame): void {
    if (frame.k === "refused") this.refusal = frame.text;
    else if (frame.k === "answer") {
      this.waiting.get(frame.id)?.(frame, frame.ok ? "acknowledged" : frame.refused === false ? "not acknowledged" : "refused");
      this.waiting.delete(frame.id);
    } else {
      if (frame.k === "snapshot") {
        this.retry = FIRST_RETRY_MS;
        this.onState("open", "");
      }
      this.onFrame(frame);
    }
  }

  private lose(): void {
    this.isOpen = false;
    for (const [id, answered] of this.waiting) {
      answered({ k: "answer", id, ok: false, text: "the connection to the server was lost before the answer came" }, "lost");
    }
    this.waiting.clear();
    // a wrong token stays wrong, and a page that made room would take that of another; a full server may have room later
    if (/token is wrong|was revoked|made room/.test(this.refusal)) this.onState("refused", this.refusal);
    else {
      this.onState(this.refusal ? "refused" : "lost", this.refusal || "the server does not answer; trying again");
      setTimeout(() => this.open(), this.retry);
      this.retry = Math.min(LONGEST_RETRY_MS, this.retry * 1.6);
    }
  }

  /** Send a request and wait for its answer; where none comes the outcome says which of three things happened. */
  ask(fields: Facts, patienceMs = ANSWER_MS): Promise<Reply> {
    const id = `${this.sender}-${this.issued++}`;
    if (!this.send({ ...fields, id })) {
      return Promise.resolve({ k: "answer", id, ok: false, text: "there is no connection to the server", outcome: "not sent", waited_s: 0 });
    }
    const asked = performance.now();
    return new Promise((resolve) => {
      const answered = (answer: Answer, outcome: Outcome): void => {
        clearTimeout(timer);
        resolve({ ...answer, outcome, waited_s: (performance.now() - asked) / 1e3 });
      };
      const timer = setTimeout(() => {
        this.waiting.delete(id);
        answered({ k: "answer", id, ok: false, text: "no answer came: the rig may be gone" }, "no answer");
      }, patienceMs);
      this.waiting.set(id, answered);
    });
  }

  send(fields: Facts): boolean {
    if (this.isOpen) this.tell({ frame: pack(fields) });
    return this.isOpen;
  }

  /** Say where the virtual hand means to be, down and across [m], now and again while it is held; null to let go. */
  mean(meant_m: number | null, isKept = false, across_m: [number, number] | null = null): void {
    this.tell({ meant: meant_m, across: across_m, isKept });
  }

  private tell(message: ToSocket): void {
    this.worker.postMessage(message);
  }
}
