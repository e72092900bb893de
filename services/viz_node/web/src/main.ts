import "./styles.css";
import { Answers } from "./answers";
import type { Cockpit } from "./cockpit";
import { Commands } from "./commands";
import { medianFrame } from "./age";
import { Connection } from "./connection";
import { Document } from "./document";
import { part } from "./dom";
import { Hand } from "./hand";
import { Image } from "./image";
import { PackagePanels } from "./packages";
import { PANELS } from "./panels";
import { NextPanel } from "./panels/next";
import type { ScenePanel } from "./panels/scene";
import type { ScopesPanel } from "./panels/scopes";
import { StatusPanel } from "./panels/status";
import type { TimelinePanel } from "./panels/timeline";
import type { ServerFrame } from "./protocol";
import { Regions } from "./regions";
import type { View } from "./scene";
import { Store } from "./store";
import { Tip } from "./tip";
import { socketUrl, takeToken } from "./token";

const WRITE_MS = 200;
const BANNERS_MS = 50;
/** From this time between two looks on the page has stood still, and what came meanwhile is still to be taken in [ms]. */
const STOOD_MS = 300;
/** For no longer than this a picture stays because of it [ms]. */
const LONGEST_WAIT_MS = 1500;
/** Frames kept for the benchmark: a minute at 60 a second. */
const FRAMES_KEPT = 3600;

const token = takeToken(location, history, () => sessionStorage);
// another address of the same server, as after it was started anew, is another token
addEventListener("hashchange", () => location.reload());
const url = socketUrl(location.href);
const store = new Store();
const connection = new Connection(url, token);
const commands = new Commands(connection, store, new Answers());
const cockpit: Cockpit = {
  store,
  connection,
  commands,
  hand: new Hand(connection, store),
  tip: new Tip(commands, store),
  image: new Image(commands, store),
  document: new Document(connection, store),
};
cockpit.hand.may = () => commands.may;
commands.onEstop = commands.onArm = () => cockpit.hand.letGo();
store.recorded = (stream, column) => cockpit.document.value(stream, column, store.at);
store.recordedSwing = () => cockpit.document.swingAt(cockpit.document.at(store.at));
const status = new StatusPanel(part("status"), cockpit);
const next = new NextPanel(part("next"), cockpit);
const regions = new Regions(PANELS, cockpit);
const packages = new PackagePanels(regions, cockpit);
const view = (regions.panel("scene") as ScenePanel).view;
const scopes = regions.panel("curves") as ScopesPanel;
const timeline = regions.panel("recording") as TimelinePanel;

/** Between frames, and what the page itself took of each, drawing and taking in what came [ms]. */
const frames: number[] = [];
const costs: number[] = [];
let taken = 0;
let built = "";
let writtenAt = 0;
let before = 0;
/** Between pictures of the rig, and when the last one came [ms]. */
const pictures: number[] = [];
let pictureAt = 0;

connection.onState = (state, text) => {
  const was = commands.link;
  commands.link = state;
  commands.linkText = text;
  document.body.dataset["link"] = state;
  // what cannot be commanded any more looks it
  if (was === "open" && state !== "open") {
    // the server has let go of it, and nothing presses again by itself once the page is back
    cockpit.hand.letGo();
    built = "";
    begin();
  }
};
connection.onFelt = (felt) => (store.felt = { ...felt, at: performance.now() });
connection.onFrame = (frame: ServerFrame) => {
  const begun = performance.now();
  if (frame.k === "snapshot") {
    store.begin(frame);
    // after every seek there is a snapshot: the page is built anew only for another source or another role
    const shown = [frame.role, frame.commands, frame.hand, frame.source.kind, frame.source.name, frame.source.length_s, Object.keys(frame.forms).length].join();
    if (shown !== built) {
      built = shown;
      cockpit.document.begin();
      cockpit.image.build();
      document.body.dataset["source"] = frame.source.kind;
      begin();
    }
    packages.begin(frame.panels ?? [], frame.problems ?? []);
  } else if (frame.k === "forms") {
    store.forms = frame.forms;
    cockpit.image.build();
    begin();
  } else if (frame.k === "tick") {
    if (pictureAt) pictures.push(begun - pictureAt);
    if (pictures.length > FRAMES_KEPT) pictures.shift();
    pictureAt = begun;
    store.pictureS = medianFrame(pictures);
    store.take(frame, begun);
    // what a package shows has come: its panel is there from now on
    if (frame.state) packages.follow();
  }
  else if (frame.k === "way") store.wayS = frame.way_s ?? NaN;
  else if (frame.k === "hand") cockpit.hand.notice(frame);
  taken += performance.now() - begun;
};

function begin(): void {
  status.begin();
  next.begin();
  regions.begin();
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
  store.frameS = medianFrame(frames);
  show(now);
  view?.follow();
  for (const { panel } of regions.placed) panel.frame?.(now);
  taken += performance.now() - begun;
  requestAnimationFrame(draw);
}

/** What the instant said whose numbers are written: they change with what is seen beside them, and otherwise not faster than they are read. */
let written = "";
let shownAt = 0;

/** Take one instant, and make words and numbers of it: the pictures of the same frame are drawn from it too. */
function show(now: number): void {
  // what waits because the page stood still comes before the next look: until then the picture is the one of before
  const stood = now - shownAt > STOOD_MS;
  shownAt = now;
  if (stood && !document.hidden && now - writtenAt < LONGEST_WAIT_MS) return;
  store.look(now);
  cockpit.hand.followTip(store.fact("afm/state/slave", "mode"), cockpit.tip.program, Number(store.fact("haptic/state/master", "session_s") ?? -1) >= 0);
  cockpit.hand.compare();
  const seen = `${status.look()} ${next.look(now)} ${seenOf()}`;
  if (seen === written && now - writtenAt <= WRITE_MS) return;
  written = seen;
  writtenAt = now;
  next.write();
  status.write();
  for (const { panel, root } of regions.placed) if (!root.hidden) panel.write?.();
}

/** What of the instant is seen in its pictures, in steps that an eye tells apart. */
function seenOf(): string {
  const step = (stream: string, column: string, size: number): number => Math.round(store.last(stream, column) / size);
  return [step("tip", "separation", 1e-9), step("hand", "position", 1e-3), step("hand", "force", 0.2), step("command", "tip_force", 0.2), step("tip", "force", 2e-9), store.isPictureOld ? Math.round(10 * store.pictureAge) : 0].join();
}

// Not with the frames alone, of which a slow machine draws few: what an operator must not overlook comes at its time.
setInterval(() => {
  const now = performance.now();
  if (now - shownAt < BANNERS_MS) return;
  show(now);
  regions.panel("hand").frame?.(now);
}, BANNERS_MS);

function setTheme(name: string): void {
  document.documentElement.dataset["theme"] = name;
  part("theme").textContent = name === "dark" ? "Light" : "Dark";
  localStorage.setItem("theme", name);
  for (const { panel } of regions.placed) panel.recolour?.();
}

part("theme").addEventListener("click", () => setTheme(document.documentElement.dataset["theme"] === "dark" ? "light" : "dark"));
setTheme(localStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
addEventListener("keydown", (event) => {
  const target = event.target as HTMLElement;
  if (target.matches("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
  // a button takes the space bar itself, and the scene and the pad their arrows
  const own = target.matches("button, summary") ? [" ", "Enter"] : target.matches("canvas, .pad") ? ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"] : [];
  if (own.includes(event.key) || timeline.key(event)) return;
  if (event.key === "p") scopes.pause();
  if (event.key === "c") scopes.toggleCursors();
  if (event.key === "m" && commands.may) part("mark").click();
  if (event.key === "o" && commands.may) part("couple").click();
  if (!event.repeat && next.key(event.key)) event.preventDefault();
  else if (event.key === "h") next.lease.first();
  // clutch and mode of the hand across the sample, where there is one
  if (event.key === "l" && commands.may) document.getElementById("lateral-clutch")?.click();
  if (event.key === "k" && commands.may) nextOption("lateral-mode");
});

/** Choose the next option of a list, as a person does. */
function nextOption(id: string): void {
  const list = document.getElementById(id) as HTMLSelectElement | null;
  if (!list || list.disabled) return;
  list.selectedIndex = (list.selectedIndex + 1) % list.options.length;
  list.dispatchEvent(new Event("change"));
}

if (!token) connection.onState("refused", "this address has no token: type telenano view --addresses where the rig runs, and open what it prints");
else connection.open();
begin();
requestAnimationFrame(draw);

/** What the benchmark and the tests read; nothing of it changes the rig. */
declare global {
  interface Window {
    telenano: { store: Store; frames: number[]; costs: number[]; connection: Connection; view: View | undefined; cockpit: Cockpit; scopes: ScopesPanel };
  }
}
window.telenano = { store, frames, costs, connection, view, cockpit, scopes };
