"""A person takes part in an experiment in the browser: consent, practice, six trials, NASA-TLX, end.

A small runner gives the cues on the bus of a real rig, as that of `telenano experiment` does. What the browser was
sent, what was recorded and what the runner was answered are compared.
"""

import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from browser_page import AXE, BESIDE_A_BROWSER, PATIENCE_S, View, browser, needs_browser, until
from stack_rig import Rig
from telenano_experiments.asked import CONSENT, CONSENT_TEXT, NASA_TLX
from telenano_experiments.bus import Answer, ExperimentBus
from telenano_experiments.journal import read as read_journal
from telenano_experiments.recorded_trial import RecordedTrial
from telenano_experiments.tasks import TASKS
from telenano_experiments.types import Trial

from telenano.extend.tasks import choice
from telenano.settings import DEFAULT_SITE_FILE

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

TRIALS = 6
LAWS = ("virtual_impedance", "wave")
PICTURE_S = 0.21875
# what would tell the condition: laws, levels, the picture's delay
TELLING = (*LAWS, "virtual impedance", "level_high", "level_low", "picture", "clean", "condition")


class Runner(threading.Thread):
    """Gives the cues of a session, and keeps what was answered."""

    def __init__(self, bus: ExperimentBus) -> None:
        super().__init__(daemon=True)
        self.bus = bus
        self.answered: list[tuple[str, Answer]] = []
        self.asked: list[Answer] = []
        self.fault: BaseException | None = None

    def run(self) -> None:
        try:
            self._session()
        except BaseException as error:  # noqa: BLE001
            self.fault = error

    def ask(self, stage: str, *arguments: Any, **more: Any) -> Answer:
        cue = self.bus.cue(stage, *arguments, **more)
        answer = self.bus.wait(cue, PATIENCE_S, self.asked.extend)
        assert answer is not None, f"nobody answered {stage}"
        self.answered.append((stage, answer))
        return answer

    def pause(self, stage: str, seconds: float, *arguments: Any, **more: Any) -> Answer | None:
        return self.bus.wait(self.bus.cue(stage, *arguments, remaining_s=seconds, **more), seconds, self.asked.extend)

    def trial(self, index: int, phase: str) -> None:
        task = TASKS["touch_and_hold"]
        p = task.parameters.model_validate({"limit_s": PATIENCE_S})
        condition = {"law": LAWS[index % 2], "level": ("level_low", "level_high")[index % 2], "delay_s": 0.0625}
        trial = Trial("P01", 1, int(phase == "main"), index, phase, task.name, {}, condition, {}, index)
        told: dict[str, Any] = {"done": index, "total": TRIALS, "practice": phase == "practice"}
        self.bus.trial(trial, state="planned", trials=TRIALS, picture_delay_s=PICTURE_S)
        # the first one is long enough for a picture of it
        self.pause("countdown", 4.0 if index == 0 and phase == "main" else 0.5, task.title, task.instruction(p), **told)
        self.bus.trial(trial, state="running", trials=TRIALS, picture_delay_s=PICTURE_S)
        button = (choice("felt", "Press at the touch", ("I feel it",)),)
        self.ask(
            "trial",
            task.title,
            course=task.target(p, 0),
            band=task.band(p),
            remaining_s=PATIENCE_S,
            questions=button,
            **told,
        )
        self.bus.trial(trial, state="done", trials=TRIALS, picture_delay_s=PICTURE_S)

    def _session(self) -> None:
        assert self.ask("consent", "Taking part", CONSENT_TEXT, questions=(CONSENT,)).values == {"consent": "yes"}
        task = TASKS["touch_and_hold"]
        self.ask("instruction", task.title, task.instruction(task.parameters()))
        self.trial(0, "practice")
        for index in range(TRIALS):
            self.trial(index, "main")
            if index == TRIALS // 2:
                self.pause("rest", 1.0, "Rest", "Rest your hand.", done=index + 1, total=TRIALS)
        self.ask("question", "The load of the task", "Rate each.", questions=NASA_TLX, done=TRIALS, total=TRIALS)
        self.bus.cue("end", "The end", "Thank you. You may close the page.", done=TRIALS, total=TRIALS)


class Listener(threading.Thread):
    """Another page of the participant, which keeps every byte that it is sent."""

    def __init__(self, address: str) -> None:
        super().__init__(daemon=True)
        base, _, self.token = address.partition("participant.html#")
        self.url, self.origin = base.replace("http", "ws", 1) + "bus", base.rstrip("/")
        self.traffic: list[bytes] = []
        self.wanted = True

    def run(self) -> None:
        asyncio.run(self._listen())

    async def _listen(self) -> None:
        from websockets.asyncio.client import connect

        async with connect(self.url, origin=self.origin, max_size=None) as socket:  # type: ignore[arg-type]
            await socket.send(msgpack.packb({"k": "hello", "token": self.token, "protocol": 1}))
            while self.wanted:
                with contextlib.suppress(TimeoutError):
                    self.traffic.append(await asyncio.wait_for(socket.recv(decode=False), 0.2))


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    found = Rig(tmp_path)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(found.sockets))
    try:
        found.start("--duration", "300", "--no-view", *BESIDE_A_BROWSER, scenario="touch")
        found.wait_until(found.running, "a running session")
        yield found
    finally:
        found.close()


class Person:
    """Who takes part, at a page."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.faults: list[str] = []
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("console", lambda line: self.faults.append(line.text) if line.type == "error" else None)
        page.set_default_timeout(PATIENCE_S * 1e3)

    def stage(self, name: str) -> None:
        until(lambda: self.page.evaluate("document.body.dataset.stage") == name, f"the stage {name}: {self.faults}")

    def begun(self, words: str) -> bool:
        """Return whether a trial runs that the page calls so, and has not been answered."""
        button = "document.querySelector('#during-felt')"
        runs = f"document.body.dataset.stage === 'trial' && {button} !== null && !{button}.disabled"
        return bool(self.page.evaluate(f"{runs} && document.querySelector('#count').textContent === {words!r}"))

    def check(self) -> None:
        """Nothing sticks out of the window, and a reader with weak eyes or a screen reader gets along."""
        assert self.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        self.page.evaluate(AXE.read_text())
        found = self.page.evaluate("axe.run({runOnly: ['wcag2a', 'wcag2aa']}).then((r) => r.violations)")
        assert [(each["id"], [node["target"] for node in each["nodes"]]) for each in found] == []

    def press(self) -> None:
        """Hold the hand down for a while, with the pointer."""
        box = self.page.locator("#hand-pad").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + 20.0
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x, y + 0.6 * box["height"], steps=6)


@pytest.mark.parametrize("size", [(1366, 768), (390, 844)], ids=["laptop", "phone"])
def test_a_person_takes_part(rig: Rig, size: tuple[int, int]) -> None:
    view = View(rig.environment)
    try:
        with ExperimentBus(DEFAULT_SITE_FILE) as bus, browser() as chromium:
            listener, runner = Listener(view.participant), Runner(bus)
            context = chromium.new_context(viewport={"width": size[0], "height": size[1]}, has_touch=size[0] < 1000)
            person = Person(context.new_page())
            person.page.goto(view.participant, wait_until="commit")
            person.page.get_by_text("The experiment has not begun").wait_for()
            cockpit = chromium.new_context(viewport={"width": size[0], "height": size[1]}).new_page()
            cockpit.goto(view.operator, wait_until="commit")
            listener.start()
            runner.start()
            take_part(person, cockpit)
            runner.join(PATIENCE_S)
            assert runner.fault is None
            listener.wanted = False
            listener.join(PATIENCE_S)
            person.stage("end")
            assert person.faults == []
            compare(rig, runner)
            traffic = b"".join(listener.traffic)
            assert len(traffic) > 100_000
            for word in TELLING:
                assert word.encode() not in traffic
            for number in (PICTURE_S, 0.0625):
                assert msgpack.packb(number) not in traffic
            assert any(answer.values.get("action") == "disturbed" for answer in runner.asked)
    finally:
        view.close()


def take_part(person: Person, cockpit: Any) -> None:
    page = person.page
    person.stage("consent")
    person.check()
    assert page.locator("#submit").is_disabled()
    page.get_by_label("yes").check()
    page.locator("#submit").click()
    person.stage("instruction")
    # by the keyboard: the button has the focus
    page.keyboard.press("Enter")
    for index in range(TRIALS + 1):
        if index == 1:
            person.stage("countdown")
        begun = f"Trial {index} of {TRIALS}" if index else "Practice"
        until(lambda begun=begun: person.begun(begun), f"the trial that is {begun}: {person.faults}")
        if index == 2:
            # a reload in the middle of a trial leads back to it, and says nothing of what was before
            page.reload(wait_until="commit")
            until(lambda begun=begun: person.begun(begun), f"the trial after a reload: {person.faults}")
        person.press()
        if index == 1:
            page.wait_for_timeout(1200.0)
            person.check()
            experimenter(cockpit)
        page.wait_for_timeout(300.0)
        # the answer that the task is about, while the hand presses
        page.keyboard.press("Space") if index % 2 else page.locator("#during-felt").dispatch_event("click")
        page.mouse.up()
    person.stage("question")
    person.check()
    # by keyboard, pointer and touch: nothing is chosen before
    for number, question in enumerate(NASA_TLX):
        scale = page.locator(f"#scale-{question.name}")
        assert scale.get_attribute("aria-valuetext") == "not answered"
        assert page.locator("#submit").is_disabled()
        if number % 2:
            scale.focus()
            page.keyboard.press("ArrowRight")
        else:
            box = scale.bounding_box()
            scale.click(position={"x": box["width"] * 0.75, "y": box["height"] / 2})
    page.locator("#submit").click()
    person.stage("end")


def experimenter(cockpit: Any) -> None:
    """See the trial with its condition, and mark it as disturbed."""
    cockpit.locator("#experiment-facts").wait_for(state="attached")
    if cockpit.locator("#tab-experiment").count():
        cockpit.locator("#tab-experiment").dispatch_event("click")
    until(lambda: "level_low" in cockpit.inner_text("#experiment-facts"), "the condition on the experimenter's page")
    cockpit.locator("#experiment-reason").fill("the door opened")
    cockpit.locator("#experiment-disturbed").dispatch_event("click")
    cockpit.locator(".answer.done").first.wait_for()


def compare(rig: Rig, runner: Runner) -> None:
    """Compare what was recorded with what the runner was answered."""

    def recorded() -> dict[str, Any]:
        kept = (row.decode() for row in rig.recording().messages("experiment/answer"))
        return {message.id: message for message in kept}

    rig.wait_until(lambda: bool(rig.recording().messages("experiment/answer")), "recorded answers")
    answers = [answer for _, answer in runner.answered] + runner.asked
    until(lambda: {answer.id for answer in answers} <= recorded().keys(), "all answers")
    found = recorded()
    for answer in answers:
        message = found[answer.id]
        assert (dict(message.values), message.role, message.given_ns) == (
            dict(answer.values),
            answer.role,
            answer.given_ns,
        )
    load = next(answer.values for stage, answer in runner.answered if stage == "question")
    assert set(load) == {question.name for question in NASA_TLX}
    assert {load["mental_demand"], load["physical_demand"]} == {75, 55}
    trials = [row.decode() for row in rig.recording().messages("experiment/trial")]
    done = [(message.phase, message.index, message.condition["law"]) for message in trials if message.state == "done"]
    assert done == [("practice", 0, LAWS[0]), *(("main", i, LAWS[i % 2]) for i in range(TRIALS))]
    # the hand of the page pressed, in the trials
    force_n = np.array([row.decode().force_n[2] for row in rig.recording().messages("operator/force")])
    assert force_n.min() < -0.5


PLAN = """
name: at_the_page
scenario: touch
settings: {haptic_node.operator.force_deadline_s: 1.0, realtime.rate_hz: 250.0}
apparatus: live
participants: 1
operator: {kind: person}
tasks:
  - name: touch_and_hold
    parameters: {limit_s: 4.0, hold_s: 0.5}
factors:
  law: [virtual_impedance, wave]
repetitions: 3
order: shuffle
practice: {trials: 1}
# a machine with a browser holds processes up: here that is no reason to repeat a trial
disturbed: {stall_s: 5.0}
ask:
  - {instrument: nasa_tlx, after: block}
"""


def test_a_person_does_a_planned_experiment(tmp_path: Path) -> None:
    plan, folder = tmp_path / "at_the_page.yaml", tmp_path / "out"
    plan.write_text(PLAN)
    with tempfile.TemporaryDirectory(prefix="tnp-") as sockets:
        environment = {**os.environ, "TELENANO_RUNTIME_DIR": sockets}
        command = [sys.executable, "-m", "telenano", "experiment", "run", str(plan), "--out", str(folder)]
        log = (tmp_path / "run.log").open("wb")
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        try:
            addresses = until(
                lambda: [path.read_text() for path in Path(sockets).glob("**/view-*.addresses")], "a page"
            )
            lines = addresses[0].splitlines()
            address = next(line.split()[1] for line in lines if line.startswith("participant:"))
            with browser() as chromium:
                person = Person(chromium.new_context(viewport={"width": 1366, "height": 768}).new_page())
                person.page.goto(address, wait_until="commit")
                trials = session(person)
                assert process.wait(PATIENCE_S) == 0, (tmp_path / "run.log").read_text()[-2000:]
                # The rig is gone, and the page has nothing to say of that, also not to one who loads it again.
                person.page.wait_for_timeout(3000.0)
                said = person.page.inner_text("body")
                assert "Thank you" in said and "connect" not in said.lower(), said
                if folder_of_pictures := os.environ.get("TELENANO_SCREENSHOTS"):
                    person.page.screenshot(path=f"{folder_of_pictures}/participant-end.png")
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(PATIENCE_S)
            log.close()
    journal = read_journal(folder / "journal.jsonl")
    attempts = [record for record in journal if record["record"] == "trial"]
    # A trial is done again where the machine held the experiment up for a second.
    rows = [row for row in attempts if row["status"] == "done"]
    assert [row["phase"] for row in rows] == ["practice"] + ["main"] * TRIALS
    assert trials == len(attempts)
    assert sorted(row["condition"]["law"] for row in rows[1:]) == sorted(LAWS * 3)
    load = next(record for record in journal if record.get("instrument") == "nasa_tlx")
    assert load["items"] == pytest.approx({each.name: 75.0 for each in NASA_TLX})
    task = TASKS["touch_and_hold"]
    p = task.parameters.model_validate({"limit_s": 4.0, "hold_s": 0.5})
    for row in rows:
        data = RecordedTrial(folder / row["recording"]).data(4.0, ())
        assert task.judge(data, p, row["seed"]) == pytest.approx(row["measures"], nan_ok=True)
        assert row["measures"]["effort_n_s"] > 0.1


def session(person: Person) -> int:
    """Go through a session as it comes, and return how many trials there were."""
    page, trials = person.page, 0
    end = time.monotonic() + 8.0 * PATIENCE_S
    before = ""
    while (stage := page.evaluate("document.body.dataset.stage")) != "end":
        assert time.monotonic() < end, f"the session does not end: {stage}, {person.faults}"
        if stage == "trial" and before != "trial":
            trials += 1
            person.press()
        elif stage != "trial" and before == "trial":
            page.mouse.up()
        if stage in ("consent", "question", "instruction"):
            answer(page)
        before = stage
        page.wait_for_timeout(50.0)
    return trials


def answer(page: Any) -> None:
    """Answer what is on the sheet, if anything is."""
    if page.locator("#go-on:not(:disabled)").count():
        page.locator("#go-on").dispatch_event("click")
    if page.get_by_label("yes").count():
        page.get_by_label("yes").check()
    for name in page.evaluate("[...document.querySelectorAll('input.untouched')].map((scale) => scale.id)"):
        page.locator(f"#{name}").focus()
        for _ in range(5):
            page.keyboard.press("ArrowRight")
    if page.locator("#submit:not(:disabled)").count():
        page.locator("#submit").dispatch_event("click")
