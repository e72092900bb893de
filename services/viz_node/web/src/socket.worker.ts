import { pack, read } from "./protocol";
import { Spring } from "./spring";

/**
 * The web socket of the page, in a thread of its own, which no drawing holds up: the force of the virtual hand goes out
 * as often and as fresh where a picture takes half a second as where it takes a hundredth of one.
 */

/** From the page: open a socket; send a frame; where the hand means to be [m], null to let go, and whether it is kept there. */
export type ToSocket = { open: string } | { frame: Uint8Array<ArrayBuffer> } | { meant: number | null; across: [number, number] | null; isKept: boolean };
/** To the page: the socket is open; a frame has come; the socket has closed. */
export type FromSocket = { k: "open" } | { k: "frame"; frame: ArrayBuffer } | { k: "closed" };

const SEND_MS = 15;

// seen from here the page is what a worker is seen from the page
const page = self as unknown as Worker;
const spring = new Spring();
let socket: WebSocket | undefined;

page.onmessage = ({ data }: MessageEvent<ToSocket>) => {
  if ("open" in data) open(data.open);
  else if ("frame" in data) send(data.frame);
  else {
    spring.mean(data.meant, data.isKept, performance.now(), data.across);
    if (data.meant === null && !data.across) push();
  }
};
setInterval(push, SEND_MS);

function open(url: string): void {
  socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => tell({ k: "open" });
  socket.onclose = () => tell({ k: "closed" });
  socket.onmessage = ({ data }: MessageEvent<ArrayBuffer>) => {
    spring.take(read(data));
    tell({ k: "frame", frame: data }, [data]);
  };
}

function push(): void {
  const force = spring.next(performance.now());
  if (force === undefined) return;
  const [across_x_n, across_y_n] = spring.acrossForce;
  send(pack({ k: "hand", force_n: force ?? 0, across_x_n, across_y_n, held: force !== null }));
}

function send(frame: Uint8Array<ArrayBuffer>): void {
  if (socket?.readyState === WebSocket.OPEN) socket.send(frame);
}

function tell(message: FromSocket, transferred: Transferable[] = []): void {
  page.postMessage(message, transferred);
}
