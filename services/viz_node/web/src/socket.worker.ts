import { Datagrams } from "./datagrams";
import { pack, read, type FeltFrame } from "./protocol";
import { Spring } from "./spring";

/**
 * The web socket of the page, in a thread of its own, which no drawing holds up: the force of the virtual hand goes out
 * as often and as fresh where a picture takes half a second as where it takes a hundredth of one.
 */

/** From the page: open a socket; send a frame; where the hand means to be [m], null to let go, and whether it is kept there. */
export type ToSocket = { open: string } | { frame: Uint8Array<ArrayBuffer> } | { meant: number | null; across: [number, number] | null; isKept: boolean };
/** The newest force that is felt [N], its age here [s], the round trip of the frame that it answers [s], and whether by datagrams. */
export interface Felt {
  force_n: number;
  age_s: number;
  round_trip_s: number;
  isDatagram: boolean;
}
/** To the page: the socket is open; a frame has come; what is felt; the socket has closed. */
export type FromSocket = { k: "open" } | { k: "felt"; felt: Felt } | { k: "frame"; frame: ArrayBuffer } | { k: "closed" };

const SEND_MS = 15;
/** A page that holds control and was not heard for a second has lost it. */
const HERE_MS = 250;

// seen from here the page is what a worker is seen from the page
const page = self as unknown as Worker;
const spring = new Spring();
let socket: WebSocket | undefined;
/** What this page is called in a lease, and the number of the one that it has, 0 for none. */
let me = "";
let lease = 0;

page.onmessage = ({ data }: MessageEvent<ToSocket>) => {
  if ("open" in data) open(data.open);
  else if ("frame" in data) send(data.frame);
  else {
    spring.mean(data.meant, data.isKept, performance.now(), data.across);
    if (data.meant === null && !data.across) push();
  }
};
setInterval(push, SEND_MS);
// not before the server has sent who this page is: its first frame is its token
setInterval(() => me && here(), HERE_MS);

function open(url: string): void {
  socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  lease = 0;
  me = "";
  socket.onopen = () => tell({ k: "open" });
  socket.onclose = () => {
    datagrams.close();
    tell({ k: "closed" });
  };
  socket.onmessage = ({ data }: MessageEvent<ArrayBuffer>) => {
    const frame = read(data);
    if (frame.k === "felt") return feel(frame, false);
    if (frame.k === "datagrams") return void datagrams.open(url, frame);
    spring.take(frame);
    if (frame.k === "way") {
      asked = [frame.stamp_s, performance.now()];
      here();
    }
    if (frame.k === "snapshot") me = frame.me ?? "";
    if ((frame.k === "snapshot" || frame.k === "tick" || frame.k === "answer") && frame.lease) lease = me && frame.lease.holder === me ? frame.lease.number : 0;
    tell({ k: "frame", frame: data }, [data]);
  };
}

/** The newest question for the way to this page [s], and when it came [ms]. */
let asked: [stamp_s: number, at: number] | undefined;

function here(): void {
  const way = asked && { stamp_s: asked[0], waited_s: (performance.now() - asked[1]) / 1e3 };
  asked = undefined;
  send(pack({ k: "here", ...way }));
}

const datagrams = new Datagrams((frame) => frame.k === "felt" && feel(frame, true));
let newestFelt = 0;

/** Take what is felt, of which the newest counts: half of the round trip is taken for its way here. */
function feel({ force_n, age_s, number, stamp_s }: FeltFrame, isDatagram: boolean): void {
  if (number <= newestFelt) return;
  newestFelt = number;
  const round_trip_s = performance.now() / 1e3 - stamp_s;
  tell({ k: "felt", felt: { force_n, age_s: age_s + round_trip_s / 2, round_trip_s, isDatagram } });
}

/** Frames of the hand since the page was loaded. */
let number = 0;

function push(): void {
  const force = spring.next(performance.now());
  if (force === undefined) return;
  const [across_x_n, across_y_n] = spring.acrossForce;
  const frame = pack({ k: "hand", force_n: force ?? 0, across_x_n, across_y_n, held: force !== null, lease, number: ++number, stamp_s: performance.now() / 1e3 });
  // that the hand has let go must come, and a lost force is replaced by the next
  if (force === null || !datagrams.send(frame)) send(frame);
}

function send(frame: Uint8Array<ArrayBuffer>): void {
  if (socket?.readyState === WebSocket.OPEN) socket.send(frame);
}

function tell(message: FromSocket, transferred: Transferable[] = []): void {
  page.postMessage(message, transferred);
}
