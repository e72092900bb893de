import { PROTOCOL, pack, read, type Answer, type Facts, type ServerFrame } from "./protocol";

const FIRST_RETRY_MS = 300;
const LONGEST_RETRY_MS = 3000;
/** The server sends thirty times a second while something changes, and answers within 5 s. */
const ANSWER_MS = 12_000;

export type LinkState = "connecting" | "open" | "lost" | "refused";

/** The web socket of the page: it says hello, comes back by itself, and matches answers to requests. */
export class Connection {
  onFrame: (frame: ServerFrame) => void = () => {};
  onState: (state: LinkState, text: string) => void = () => {};
  /** When the last frame came, on the clock of the page [ms]. */
  heard = 0;
  bytes = 0;
  private socket: WebSocket | undefined;
  private retry = FIRST_RETRY_MS;
  private issued = 0;
  private readonly sender = crypto.getRandomValues(new Uint32Array(2)).join("");
  private readonly waiting = new Map<string, (answer: Answer) => void>();

  constructor(
    private readonly url: string,
    private readonly token: string,
  ) {}

  open(): void {
    this.onState("connecting", "connecting to the server");
    const socket = new WebSocket(this.url);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    let refusal = "";
    socket.onopen = () => socket.send(pack({ k: "hello", token: this.token, protocol: PROTOCOL }));
    socket.onmessage = (message: MessageEvent<ArrayBuffer>) => {
      this.heard = performance.now();
      this.bytes += message.data.byteLength;
      const frame = read(message.data);
      if (frame.k === "refused") refusal = frame.text;
      else if (frame.k === "answer") {
        this.waiting.get(frame.id)?.(frame);
        this.waiting.delete(frame.id);
      } else {
        if (frame.k === "snapshot") {
          this.retry = FIRST_RETRY_MS;
          this.onState("open", "");
        }
        this.onFrame(frame);
      }
    };
    socket.onclose = () => {
      for (const [id, answered] of this.waiting) {
        answered({ k: "answer", id, ok: false, text: "the connection to the server was lost before the answer came" });
      }
      this.waiting.clear();
      // a wrong token stays wrong; a full server may have room later
      if (refusal.includes("token")) this.onState("refused", refusal);
      else {
        this.onState(refusal ? "refused" : "lost", refusal || "the server does not answer; trying again");
        setTimeout(() => this.open(), this.retry);
        this.retry = Math.min(LONGEST_RETRY_MS, this.retry * 1.6);
      }
    };
  }

  /** Send a request and wait for its answer; one that never comes is a refusal in words. */
  ask(fields: Facts): Promise<Answer> {
    const id = `${this.sender}-${this.issued++}`;
    if (!this.send({ ...fields, id })) {
      return Promise.resolve({ k: "answer", id, ok: false, text: "not sent: there is no connection to the server" });
    }
    return new Promise((resolve) => {
      const timer = setTimeout(() => {
        this.waiting.delete(id);
        resolve({ k: "answer", id, ok: false, text: "no answer came: the rig may be gone" });
      }, ANSWER_MS);
      this.waiting.set(id, (answer) => {
        clearTimeout(timer);
        resolve(answer);
      });
    });
  }

  send(fields: Facts): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(pack(fields));
    return true;
  }
}
