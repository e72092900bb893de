// A hand in Node with zeromq and @msgpack/msgpack, from proto/ alone: node hand_client.mjs OWN_ENDPOINT RIG_ENDPOINT
// SECONDS STOP_AFTER_S RATE_HZ. It goes where haptic/command says, obeys a stop, and gives one of its own; 0 for none.
// tcp:// is CURVE, with the key file $HAND_KEY_FILE, and $RIG_KEY as the one public key of the rig's machine.
import { createRequire } from "node:module";
import { admit, keysOf } from "./keys.mjs";

const installed = createRequire(`${process.env.CLIENT_PACKAGES}/`);
const { decode, encode } = installed("@msgpack/msgpack");
const { Publisher, Reply, Subscriber } = installed("zeromq");
const [own, rig, seconds, stopAfter, rateHz] = process.argv.slice(2);
const [NODE, OWN_STOP] = ["haptic_node@master", "n-stop-1"];
const KNOWN = "seq t_ns src v run id command target parameters validity_s node_t_ns node_latch by".split(" ");
const TAKES = ["arm", "estop", "start", "stop"];
const offset = BigInt(Date.now()) * 1_000_000n - process.hrtime.bigint();
const now = () => process.hrtime.bigint() + offset;
const began = now(), run = (began / 1000n) & 0xffffffffn;
const keys = process.env.HAND_KEY_FILE ? keysOf(process.env.HAND_KEY_FILE) : {};
const server = own.startsWith("tcp:") ? { curveServer: true, curveSecretKey: keys.secretKey } : {};
const theirs = { curveServerKey: process.env.RIG_KEY, curvePublicKey: keys.publicKey, curveSecretKey: keys.secretKey };
const publisher = new Publisher({ sendHighWaterMark: 22_000, linger: 1000, ...server });
const reader = new Subscriber({ receiveHighWaterMark: 22_000, linger: 0, heartbeatInterval: 200, ...(rig.startsWith("tcp:") ? theirs : {}) });
const [sent, done, still] = [{}, new Map(), [0.0, 0.0, 0.0]];
const hand = { position: still, force: still, mode: "off", seq: 0n, t: 0n, at: 0n };
let [tip, latch, stoppedAt, isLatched, isArmed, isGiven] = [still, "", 0n, false, false, false];

// A JavaScript number is packed as a float 64 and a BigInt as an integer.
const FORM = { useBigInt64: true, forceIntegerToFloat: true };
let [queue, isSending] = [[], false];
async function send(topic, fields, src = NODE) {
  sent[topic] = (sent[topic] ?? 0n) + 1n;
  queue.push([topic, encode({ seq: sent[topic] - 1n, t_ns: now(), src, v: 1n, run, ...fields }, FORM)]);
  if (isSending) return;
  isSending = true;
  while (queue.length) await publisher.send(queue.shift());
  isSending = false;
}
function answer(asked, reason, more = {}) { // an empty reason acknowledges
  const stop = latch ? { latch, latched: isLatched, estop_age_s: Number(now() - stoppedAt) / 1e9 } : {};
  const data = { command: asked.command, target: asked.target, giver: asked.src, sent_t_ns: asked.t_ns, ...stop, ...more };
  send("session/event", { id: asked.id, kind: reason ? "refused" : "ack", level: reason ? "warning" : "info", text: reason, data });
}
function stop(id) { [latch, stoppedAt, isLatched, isArmed] = [id, now(), true, false]; }
function matches(pattern) {
  const parts = pattern.replace(/[.+^${}()|\\]/g, "\\$&").replace(/\*/g, ".*").replace(/\?/g, ".").replace(/\[!/g, "[^");
  try { return new RegExp(`^(?:${parts})$`).test(NODE); } catch { return false; }
}
function control(asked) {
  const isNamed = asked.target === NODE || asked.target === "haptic_node";
  if (!asked.id || !asked.parameters || typeof asked.target !== "string" || !(isNamed || matches(asked.target))) return;
  if (done.has(asked.id)) return answer(asked, done.get(asked.id));
  const age = now() - BigInt(asked.node_t_ns?.[NODE] ?? asked.t_ns);
  const isStop = ["estop", "stop"].includes(asked.command);
  if (!isStop && (age > BigInt(Math.round(1e9 * Number(asked.validity_s ?? 1))) || age < -100_000_000n))
    return answer(asked, "the command has expired", { expired: true });
  const unknown = Object.keys(asked).find((key) => !KNOWN.includes(key));
  if (unknown) return answer(asked, `the key ${unknown} is not known`);
  if (!TAKES.includes(asked.command) && !isNamed) return;
  if (asked.command === "arm" && latch && asked.node_latch?.[NODE] !== latch)
    return answer(asked, "it was stopped since: quote that stop");
  if (asked.command === "estop") stop(asked.id);
  if (asked.command === "arm") [isArmed, isLatched] = [true, false];
  done.set(asked.id, TAKES.includes(asked.command) ? "" : `this hand knows no ${asked.command}`);
  answer(asked, done.get(asked.id));
}
function take(topic, fields) {
  if (topic === "session/control") control(fields);
  else if (topic === "session/event") isGiven ||= fields.id === OWN_STOP && fields.kind === "ack";
  else if (topic === "afm/state") tip = fields.tip_force_n ?? tip;
  else if (topic === "haptic/command" && !isLatched && fields.hand_t_ns !== undefined) {
    Object.assign(hand, { position: fields.position_m.map(Number), force: fields.force_n.map(Number), mode: fields.mode });
    Object.assign(hand, { seq: BigInt(fields.hand_seq), t: BigInt(fields.hand_t_ns), at: now() });
  }
}
function sendState() {
  const isFresh = !isLatched && hand.t > 0 && now() - hand.at < 50_000_000n;
  send("haptic/state", {
    position_m: hand.position, reference_m: hand.position, velocity_m_per_s: still, operator_force_n: still,
    motor_force_n: isFresh ? hand.force : still, mode: isFresh ? hand.mode : "off",
    estop: isLatched, limited: false, armed: isArmed, session_s: -1, step_s: 1 / rateHz,
    answered_seq: hand.seq, answered_t_ns: hand.t, answered_at_ns: hand.at,
  });
}
function sendHealth() {
  const late = { lateness_p50_s: 0, lateness_p99_s: 0, lateness_max_s: 0, cpu_percent: 0 };
  const rates = { uptime_s: Number(now() - began) / 1e9, rate_hz: Number(rateHz), period_s: 1 / rateHz, overruns: 0n };
  const process_ = { pid: BigInt(process.pid), memory_bytes: 0n, realtime: false, memory_locked: false, replay: false };
  send("node/health", { state: isLatched ? "safe" : "running", rejected: {}, inputs: [], ...late, ...rates, ...process_ });
}
const zap = new Reply({ linger: 0 });
await zap.bind("inproc://zeromq.zap.01");
if (server.curveServer) admit(zap, [theirs.curveServerKey, keys.publicKey]);
await publisher.bind(own);
rig.split(",").forEach((each) => reader.connect(each));
reader.subscribe("haptic/command", "afm/state", "session/control", "session/event");
const until = began + BigInt(Math.round(1e9 * seconds)), gives = began + BigInt(Math.round(1e9 * stopAfter));
(async () => {
  for await (const [topic, payload, ...more] of reader) {
    try {
      const fields = payload && !more.length ? decode(payload, { useBigInt64: true }) : null;
      if (fields && Number(fields.v) === 1 && fields.seq >= 0) take(topic.toString(), fields);
    } catch { /* what cannot be read is left out */ }
  }
})();
const period = BigInt(Math.round(1e9 / rateHz));
let [reported, given] = [0n, 0n];
for (let due = began; due < until; due += period) {
  while (now() < due) await new Promise((wake) => setTimeout(wake, 1));
  sendState();
  if (due >= reported) { sendHealth(); reported = due + 500_000_000n; }
  if (gives === began || now() < gives || isGiven || due < given) continue;
  given = due + 50_000_000n;
  if (latch !== OWN_STOP) stop(OWN_STOP);
  send("session/control", { id: OWN_STOP, command: "estop", target: "*", parameters: {} }, "estop@master");
}
const counts = Object.fromEntries(Object.entries(sent).map(([topic, count]) => [`sent.${topic}`, count]));
counts["sent.session/event"] = (sent["session/event"] ?? 0n) + 1n;
while (isSending) await new Promise((wake) => setTimeout(wake, 1));
await send("session/event", { id: "", kind: "node", level: "info", text: "the hand has ended", data: { state: "ended", ...counts } });
console.log(JSON.stringify({ tip_force_n: tip.map(Number), stop_was_heard: isGiven }));
[reader, publisher, zap].forEach((socket) => socket.close());
