import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { outcomeText } from "../src/answers";
import { Connection, type Reply } from "../src/connection";
import { pack, read } from "../src/protocol";
import { Store } from "../src/store";

/** The thread of the socket, as far as the page sees it. */
class Socket {
  static newest: Socket;
  onmessage: (event: { data: object }) => void = () => {};
  readonly sent: Record<string, unknown>[] = [];
  constructor() {
    Socket.newest = this;
  }
  postMessage(message: { frame?: Uint8Array<ArrayBuffer> }): void {
    if (message.frame) this.sent.push(read(message.frame.slice().buffer) as never);
  }
  say(data: object): void {
    this.onmessage({ data });
  }
  answer(ok: boolean, text: string, further: object = {}): void {
    this.say({ k: "frame", frame: pack({ k: "answer", id: this.sent.at(-1)!["id"], ok, text, ...further }).slice().buffer });
  }
}

beforeEach(() => {
  vi.useFakeTimers();
  vi.stubGlobal("Worker", Socket);
});
afterEach(() => {
  vi.unstubAllGlobals();
  vi.useRealTimers();
});

/** What a page says of a request, as it happened. */
async function said(happens: (connection: Connection, socket: Socket) => Promise<Reply>): Promise<string> {
  const connection = new Connection("ws://rig/bus", "token");
  const { outcome, text, waited_s } = await happens(connection, Socket.newest);
  return outcomeText("Start", outcome, text, waited_s);
}

test("each of the six things that can become of a request is called by its name", async () => {
  const begun = (after: (socket: Socket) => void) => (connection: Connection, socket: Socket): Promise<Reply> => {
    socket.say({ k: "open" });
    const reply = connection.ask({ k: "command" });
    after(socket);
    return reply;
  };
  expect(await said(begun((socket) => socket.answer(true, "started")))).toBe("Start: acknowledged · started");
  expect(await said(begun((socket) => socket.answer(false, "it runs")))).toBe("Start: refused · it runs");
  // what no node refused is not called refused
  const away = "afm_node@slave absent: is not running";
  expect(await said(begun((socket) => socket.answer(false, away, { refused: false })))).toBe(`Start: not acknowledged by all that were asked · ${away}`);
  expect(await said((connection) => connection.ask({ k: "command" }))).toBe("Start: not sent · there is no connection to the server");
  const lost = begun((socket) => {
    vi.advanceTimersByTime(400);
    socket.say({ k: "closed" });
  });
  expect(await said(lost)).toBe("Start: connection lost after 0.4 s, before the answer · it may have been carried out, or not");
  expect(await said(begun(() => vi.advanceTimersByTime(12_000)))).toMatch(/^Start: no answer in 12 s · it may have been carried out, or not/);
  // an answer that comes later is not that of another request
  const late = begun((socket) => {
    vi.advanceTimersByTime(12_000);
    socket.answer(true, "late");
  });
  expect(await said(late)).toMatch(/no answer/);
});

test("what this page noted stays among the events over a lost connection, at its time", () => {
  const store = new Store();
  const events = (t: number): object[] => [{ src: "afm_node@slave", seq: 1, t, kind: "mode", level: "info", text: "node" }];
  const snapshot = (kind: string, t: number): never => ({ k: "snapshot", role: "operator", commands: true, hand: true, forms: {}, source: { kind, name: "" }, streams: [], events: events(t) }) as never;
  store.begin(snapshot("live", 1));
  store.note("warning", "Start: connection lost");
  store.begin(snapshot("live", (Date.now() + 1000) * 1e6));
  expect(store.events.map(({ text }) => text)).toEqual(["Start: connection lost", "node"]);
  // a recording has the events of its own time alone
  store.begin(snapshot("recording", 1));
  store.note("info", "no event of it");
  expect(store.events.map(({ text }) => text)).toEqual(["node"]);
});
