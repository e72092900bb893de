import { Connection, Hand, Store, Surface, View, ageWords, make, part, socketUrl, takeToken } from "../../kit.js";
import { Remaining, answerOf, countOf, courseOf, cueOf, directionOf, label } from "./cue.js";
import { QuestionForm } from "./form.js";
import { TargetView } from "./target.js";

/** The page of a participant: what to do, the target, the hand, and questions. It is told nothing of the condition. */
const CUE = "experiment/cue";
const AGAIN_MS = 500;
const token = takeToken(location, history, () => sessionStorage);
addEventListener("hashchange", () => location.reload());
const store = new Store();
const connection = new Connection(socketUrl(new URL("../../", location.href).href), token);
const hand = new Hand(connection, store);
const remaining = new Remaining();
const [sheet, trial, note] = [part("sheet"), part("trial"), part("note")];
const target = new TargetView(part("follow"), store);
const buttons = make("div", { class: "row", id: "buttons" });
let link = "connecting";
let linkText = "";
let cue;
let course;
let view;
let dirty = false;
let wasOld = false;

hand.may = () => link === "open" && cue?.stage === "trial";
part("hand").append(hand.pad, make("div", { class: "row tight" }, hand.keepButton), hand.text, buttons);
connection.onState = (state, text) => {
  link = state;
  linkText = text;
  document.body.dataset["link"] = state;
  show();
};
connection.onFrame = (frame) => {
  if (frame.k === "snapshot") store.begin(frame);
  else if (frame.k === "tick") store.take(frame);
  else if (frame.k === "hand") hand.notice(frame);
  dirty = true;
  const found = cueOf(store.state.get(CUE));
  if (found && remaining.take(found, performance.now())) {
    cue = found;
    course = courseOf(found);
    hand.letGo();
    show();
  } else if (!found && frame.k === "snapshot") show();
};

/** Send an answer to the cue that is shown, again while nobody takes it and the cue stands; whether it was taken. */
async function give(values) {
  const asked = cue;
  const shown_s = remaining.shown(performance.now());
  note.textContent = "";
  while (asked && asked.id === cue?.id) {
    if ((await connection.ask(answerOf(asked.id, values, shown_s))).ok) return true;
    if (asked.id === cue?.id)
      note.textContent = "Your answer has not arrived, and is sent again. Tell the experimenter if this stays.";
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
  }
  return false;
}

function show() {
  note.textContent = "";
  const isTrial = link === "open" && cue?.stage === "trial";
  trial.hidden = !isTrial;
  sheet.hidden = isTrial;
  document.body.dataset["stage"] = cue?.stage ?? "";
  part("progress").hidden = !cue?.total;
  if (cue) {
    part("title").textContent = cue.title || "telenano";
    part("count").textContent = countOf(cue);
    document.documentElement.lang = label(cue, "language");
    sheet.dir = directionOf(document.documentElement.lang);
    Object.assign(part("done"), { max: Math.max(1, cue.total), value: cue.done });
  }
  if (isTrial) beginTrial(cue);
  else sheet.replaceChildren(make("div", { class: "card" }, ...card()));
  sheet.querySelector("input, button")?.focus({ preventScroll: true });
}

/** What is on the sheet between trials. */
function card() {
  // The rig ends with the session, and its connection with it.
  if (link !== "open" && cue?.stage !== "end") return [make("h2", {}, "Not connected"), make("p", {}, linkText)];
  if (!cue) return [make("h2", {}, "Please wait"), make("p", {}, "The experiment has not begun.")];
  const found = [make("h2", {}, cue.title), ...cue.text.split("\n").map((text) => make("p", {}, text))];
  if (cue.remaining_s !== null) found.push(make("p", { class: "left", id: "left" }, ""));
  if (cue.questions.length) found.push(formOf(cue.questions).root);
  else if (cue.remaining_s === null && cue.stage !== "pause" && cue.stage !== "end") found.push(goOn());
  return found;
}

function formOf(questions) {
  const answer = (given) => {
    form.busy(true);
    void give(given).then((ok) => form.busy(ok));
  };
  const form = new QuestionForm(questions, answer, label(cue, "submit"));
  return form;
}

function goOn() {
  const button = make("button", { type: "button", class: "go", id: "go-on" }, label(cue, cue?.stage === "instruction" ? "begin" : "end_rest"));
  button.addEventListener("click", () => {
    button.disabled = true;
    void give({ ready: "yes" }).then((ok) => (button.disabled = ok));
  });
  return button;
}

function beginTrial(shown) {
  target.begin(shown, course);
  hand.begin();
  trial.dataset["quantity"] = shown.quantity;
  buttons.replaceChildren(...shown.questions.map(({ name, options }) => {
    const button = make("button", { type: "button", class: "go", id: `during-${name}` }, options[0] ?? name);
    button.addEventListener("click", () => {
      button.disabled = true;
      void give({ [name]: options[0] ?? "yes" }).then((ok) => (button.disabled = ok));
    });
    return button;
  }));
  if (view) return;
  try {
    view = new View(part("scene"), store, new Surface());
    view.onPress = (down) => hand.pull(down);
    view.offer(true, false);
    store.onLines = (lines) => view?.addLines(lines);
    store.onRestart = () => view?.clear();
  } catch {
    // a browser without WebGL has the target and the pad
    part("scene").hidden = true;
  }
}

/** What is not of the present is grey, and its hand is let go: the server has let it go as well. */
function lookAtAge() {
  store.look(performance.now());
  const isOld = link === "open" && cue?.stage === "trial" && store.isPictureOld;
  if (isOld) hand.letGo();
  const text = isOld ? `Not connected for ${ageWords(store.pictureAge)}: your hand is let go. Tell the experimenter if this stays.` : "";
  if (isOld || wasOld) note.textContent = text;
  trial.toggleAttribute("data-old", isOld);
  wasOld = isOld;
}

function draw() {
  lookAtAge();
  const left = remaining.left(performance.now());
  if (cue?.stage === "trial" && !trial.hidden) {
    const end = course ? course.times[course.times.length - 1] : 0;
    target.draw(course && left !== null ? Math.max(0, end - left) : remaining.shown(performance.now()));
    hand.draw();
    if (dirty) view?.follow();
    dirty = false;
  } else if (left !== null) {
    const text = cue?.stage === "countdown" ? String(Math.ceil(left)) : `${Math.ceil(left)} s`;
    const shown = document.getElementById("left");
    if (shown && shown.textContent !== text) shown.textContent = text;
  }
  requestAnimationFrame(draw);
}

function stop() {
  hand.letGo();
  void connection.ask({ k: "estop" }).then(({ ok, outcome, text }) => (note.textContent = ok ? "Stopped." : `STOP: ${outcome} · ${text}`));
}

part("estop").addEventListener("click", stop);
addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat) stop();
  const first = buttons.querySelector("button:not(:disabled)");
  if (event.key === " " && cue?.stage === "trial" && first) {
    event.preventDefault();
    first.click();
  }
});
document.documentElement.dataset["theme"] = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
if (token) connection.open();
else
  connection.onState("refused", "Open the address that the experimenter gives you: it ends with a token.");
requestAnimationFrame(draw);
/** What the tests read; nothing of it changes the rig. */
window.participant = { store, hand };
