import "./styles.css";
import { Connection } from "./connection";
import { Controls } from "./controls";
import { make, part } from "./dom";
import { Hand } from "./hand";
import { Instrument } from "./instrument";
import type { ServerFrame } from "./protocol";
import { Scopes } from "./scopes";
import { Status } from "./status";
import { Store } from "./store";
import { takeToken } from "./token";
import { View } from "./scene";

const STATUS_MS = 200;
const BANNERS_MS = 50;
/** Frames kept for the benchmark: a minute at 60 a second. */
const FRAMES_KEPT = 3600;

const token = takeToken(location, history, () => sessionStorage);
// another address of the same server, as after it was started anew, is another token
addEventListener("hashchange", () => location.reload());
const url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/bus`;
const store = new Store();
const connection = new Connection(url, token);
const status = new Status(store);
const scopes = new Scopes(part("scopes"), store);
const controls = new Controls(connection, store);
const hand = new Hand(connection, store);
const instrument = new Instrument(controls, store);
controls.onEstop = () => hand.letGo();
let view: View | undefined;
try {
  view = new View(part("scene"), store);
  view.onPlace = (x, y) => instrument.moveTo(x, y);
  view.headset.onPress = (down) => hand.press(down);
  view.headset.onStop = () => void controls.estop();
  store.onLines = (lines) => view?.addLines(lines);
  store.onRestart = () => view?.clear();
} catch (error) {
  part("scene").append(make("p", { class: "note error" }, `No picture in three dimensions: ${String(error)}. Everything else works.`));
}

/** Between frames, and what the page itself took of each, drawing and taking in what came [ms]. */
const frames: number[] = [];
const costs: number[] = [];
let taken = 0;
let dirty = false;
let statusAt = 0;
let before = 0;

connection.onState = (state, text) => status.setConnection(state, text);
connection.onFrame = (frame: ServerFrame) => {
  const begun = performance.now();
  if (frame.k === "snapshot") {
    store.begin(frame);
    hand.build();
    build();
  } else if (frame.k === "forms") {
    store.forms = frame.forms;
    build();
  } else if (frame.k === "tick") store.take(frame);
  else if (frame.k === "hand") hand.refuse(frame.text);
  dirty = true;
  taken += performance.now() - begun;
};

function build(): void {
  controls.build();
  instrument.build();
  if (view) view.placeButton.hidden = !(instrument.isThere && store.role === "operator");
}

function draw(now: number): void {
  const begun = performance.now();
  if (before) {
    frames.push(now - before);
    costs.push(taken + (view?.takeCost() ?? 0));
    taken = 0;
  }
  for (const kept of [frames, costs]) if (kept.length > FRAMES_KEPT) kept.shift();
  before = now;
  if (dirty) {
    dirty = false;
    view?.follow();
  }
  scopes.draw(now);
  hand.draw();
  if (now - statusAt > STATUS_MS) {
    statusAt = now;
    status.draw();
    controls.draw();
    instrument.draw();
    view?.write();
  }
  taken += performance.now() - begun;
  requestAnimationFrame(draw);
}

// not with the frames, of which a slow machine draws few: what an operator must not overlook comes at its time
setInterval(() => {
  store.clock.tick(performance.now());
  status.drawBanners();
}, BANNERS_MS);

function setTheme(name: string): void {
  document.documentElement.dataset["theme"] = name;
  part("theme").textContent = name === "dark" ? "Light" : "Dark";
  localStorage.setItem("theme", name);
  scopes.recolour();
  view?.recolour();
}

part("theme").addEventListener("click", () => setTheme(document.documentElement.dataset["theme"] === "dark" ? "light" : "dark"));
setTheme(localStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
addEventListener("keydown", (event) => {
  if (event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement || event.ctrlKey || event.metaKey) return;
  if (event.key === "p") scopes.pause();
  if (event.key === "m") part("mark").click();
});
if (!token) status.setConnection("refused", "open the address that `telenano view` printed: it ends with a token");
else connection.open();
requestAnimationFrame(draw);

/** What the benchmark and the tests read; nothing of it changes the rig. */
declare global {
  interface Window {
    telenano: { store: Store; frames: number[]; costs: number[]; connection: Connection; view: View | undefined };
  }
}
window.telenano = { store, frames, costs, connection, view };
