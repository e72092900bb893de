import { make } from "../../kit.js";

/** Questions to a participant, answered by keyboard, pointer or touch; nothing is chosen beforehand. */
export class QuestionForm {
  questions;
  onGiven;
  root;
  given = {};
  submit;

  constructor(questions, onGiven, submit = "Continue") {
    this.questions = questions;
    this.onGiven = onGiven;
    this.submit = make("button", { type: "submit", class: "go", id: "submit", disabled: true }, submit);
    const fields = questions.map((question) => (question.options.length ? this.choice(question) : this.scale(question)));
    this.root = make("form", { class: "questions" }, ...fields, make("div", { class: "row" }, this.submit));
    this.root.addEventListener("submit", (event) => {
      event.preventDefault();
      if (this.isWhole) this.onGiven({ ...this.given });
    });
  }

  /** Whether every question was answered. */
  get isWhole() {
    return this.questions.every(({ name }) => name in this.given);
  }

  /** While an answer is on its way it cannot be given again. */
  busy(is) {
    this.submit.disabled = is || !this.isWhole;
  }

  give(name, value) {
    this.given[name] = value;
    this.submit.disabled = !this.isWhole;
  }

  choice(question) {
    const options = question.options.map((option, i) => {
      const input = make("input", { type: "radio", name: question.name, id: `${question.name}-${i}`, value: option, onchange: () => this.give(question.name, option) });
      return make("label", { class: "option", for: `${question.name}-${i}` }, input, make("span", {}, option));
    });
    return make("fieldset", { class: "question", id: `question-${question.name}` }, make("legend", {}, question.text), make("div", { class: "options" }, ...options));
  }

  /** A scale has no value until it was touched: a mark in its middle would be an answer. */
  scale(question) {
    const { name, least, most } = question;
    const step = question.step > 0 ? question.step : (most - least) / 100;
    const input = make("input", { type: "range", id: `scale-${name}`, min: least, max: most, step, value: least + step * Math.round((most - least) / 2 / step), class: "untouched", "aria-label": question.text, "aria-valuetext": "not answered" });
    const shown = make("output", { for: `scale-${name}` }, "–");
    const take = () => {
      input.classList.remove("untouched");
      input.setAttribute("aria-valuetext", `${input.value}, from ${question.low} to ${question.high}`);
      shown.textContent = input.value;
      this.give(name, Number(input.value));
    };
    for (const event of ["input", "change", "pointerup"]) input.addEventListener(event, take);
    // the value in the middle is chosen by the keyboard as well
    input.addEventListener("keydown", (event) => {
      if (event.key === " " || event.key === "Enter") {
        event.preventDefault();
        take();
      }
    });
    const count = Math.round((most - least) / step) + 1;
    const ticks = make("div", { class: "ticks", "aria-hidden": "true" }, ...Array.from({ length: Math.min(count, 31) }, () => make("i")));
    const ends = make("div", { class: "ends" }, make("span", {}, question.low), shown, make("span", {}, question.high));
    return make("fieldset", { class: "question", id: `question-${name}` }, make("legend", {}, question.text), input, ticks, ends);
  }
}
