import { make as element } from "../../kit.js";
import { answerOf, cueOf } from "./cue.js";

const CUE = "experiment/cue";
const TRIAL = "experiment/trial";
const STAGES = {
  consent: "asked for consent",
  instruction: "reads the instruction",
  countdown: "sees the countdown",
  trial: "does the trial",
  rest: "rests",
  question: "answers questions",
  pause: "sees a pause",
  end: "has finished",
};
/** What asks for a reason, and the button that is shown as pressed in a state. */
const ACTIONS = [
  ["pause", "Pause", "The experiment stands still after this trial"],
  ["resume", "Resume", "The experiment continues"],
  ["disturbed", "Mark disturbed", "This trial was disturbed, and is repeated by the rule of the experiment"],
  ["skip", "Skip trial", "This trial is left out"],
  ["exclude", "Exclude", "The data of this participant do not count; give a reason"],
];

/** For the experimenter: the trial with its condition, the participant's page, progress, and what can be done. */
class ExperimentPanel {
  cockpit;
  facts = element("dl", { class: "facts", id: "experiment-facts" });
  state = element("p", { id: "experiment-state", role: "status" }, "");
  progress = element("progress", { id: "experiment-progress", "aria-label": "Trials that are over" });
  reason = element("input", { id: "experiment-reason", type: "text", placeholder: "Reason", "aria-label": "Reason", maxlength: 200 });
  buttons = ACTIONS.map(([action, text, title]) => element("button", { type: "button", id: `experiment-${action}`, title, onclick: () => void this.act(action) }, text));
  shown = "";

  constructor(root, cockpit) {
    this.cockpit = cockpit;
    root.append(this.state, element("div", { class: "row" }, ...this.buttons, this.reason), this.progress, this.facts);
  }

  begin() {
    for (const control of [...this.buttons, this.reason]) control.disabled = !this.cockpit.commands.may;
  }

  write() {
    const { store } = this.cockpit;
    const [trial, cue] = [store.state.get(TRIAL), cueOf(store.state.get(CUE))];
    const left = cue?.remaining_s === null || cue === undefined ? "" : `, ${Math.ceil(cue.remaining_s)} s`;
    const rows = trial ? rowsOf(trial) : [];
    const state = `${trial ? `Trial ${trial["state"]}${trial["text"] ? `: ${trial["text"]}` : ""}. ` : ""}${cue ? `The participant ${STAGES[cue.stage] ?? cue.stage}${left}.` : "No cue yet."}`;
    const text = JSON.stringify([rows, state, cue?.done, cue?.total]);
    if (text === this.shown) return;
    this.shown = text;
    this.state.textContent = state;
    Object.assign(this.progress, { max: Math.max(1, cue?.total ?? 1), value: cue?.done ?? 0 });
    this.facts.replaceChildren(...rows.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]));
  }

  async act(action) {
    const { commands, store } = this.cockpit;
    const reason = this.reason.value.trim();
    if (action === "exclude" && !reason) {
      commands.show(action, false, "give a reason, which is kept with the exclusion");
      this.reason.focus();
      return;
    }
    const cue = cueOf(store.state.get(CUE));
    if (await commands.ask(action, answerOf(cue?.id ?? "none", { action, reason }, 0))) this.reason.value = "";
  }
}

function rowsOf(trial) {
  const condition = Object.entries((trial["condition"] ?? {})).map(([name, level]) => [name, String(level)]);
  const number = Number(trial["index"]) + 1;
  return [
    ["Participant", `${trial["participant"]}, session ${trial["session"]}`],
    ["Trial", `${number}${trial["trials"] ? ` of ${trial["trials"]}` : ""}, block ${Number(trial["block"])}, attempt ${Number(trial["attempt"]) + 1}`],
    ["Task", `${trial["task"]} (${trial["phase"]})`],
    ...condition,
    ["Picture late by", `${(1e3 * Number(trial["picture_delay_s"])).toFixed(0)} ms`],
  ];
}

export const make = (root, cockpit) => new ExperimentPanel(root, cockpit);
