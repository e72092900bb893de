"""A person takes part in an experiment, another assembles particles: what is on the bus and in the files is judged.

A small runner gives the cues of an experiment on the bus of a real rig, as that of `telenano experiment` does; then
that command runs a planned one. What a browser of a participant is sent is judged by `test_viz_participant`.
"""

import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import AXE, BESIDE_A_BROWSER, PATIENCE_S, Page, View, has, needs_browser, open_page, until
from page_walks import step
from stack_rig import Rig
from telenano_lab.assembly.particles.settings import ParticlesConfig
from telenano_lab.assembly.push_program import AT_GOAL
from telenano_lab.experiments.asked import CONSENT, CONSENT_TEXT, NASA_TLX
from telenano_lab.experiments.bus import Answer, ExperimentBus
from telenano_lab.experiments.extend import choice
from telenano_lab.experiments.journal import read as read_journal
from telenano_lab.experiments.recorded_trial import RecordedTrial
from telenano_lab.experiments.tasks import TASKS
from telenano_lab.experiments.types import Trial

from telenano.recording.reader import Recording
from telenano.settings import DEFAULT_SITE_FILE

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

TRIALS = 4
LAWS = ("virtual_impedance", "wave")
PICTURE_S = 0.21875
# two windows: name, width and height
SIZES = (("laptop", 1366, 768), ("phone", 390, 844))


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


@pytest.fixture
def touched(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Rig:
    """Run a rig for an experiment, whose bus is that of this process."""
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(rig.sockets))
    rig.start("--duration", "300", "--no-view", *BESIDE_A_BROWSER, scenario="touch")
    rig.wait_until(rig.running, "a running session")
    return rig


class Person(Page):
    """Who takes part, at a page."""

    def stage(self, name: str) -> None:
        until(lambda: self.page.evaluate("document.body?.dataset.stage") == name, f"the stage {name}: {self.faults}")

    def begun(self, words: str) -> bool:
        """Return whether a trial runs that the page calls so, and has not been answered."""
        button = "document.querySelector('#during-felt')"
        runs = f"document.body?.dataset.stage === 'trial' && {button} !== null && !{button}.disabled"
        return bool(self.page.evaluate(f"{runs} && document.querySelector('#count').textContent === {words!r}"))

    def check(self) -> None:
        """Nothing sticks out of a window, and a reader with weak eyes or a screen reader gets along."""
        self.page.evaluate(AXE.read_text())
        for name, width, height in SIZES:
            self.page.set_viewport_size({"width": width, "height": height})
            assert self.page.evaluate("document.documentElement.scrollWidth <= innerWidth"), name
            found = self.page.evaluate("axe.run({runOnly: ['wcag2a', 'wcag2aa']}).then((r) => r.violations)")
            assert [(each["id"], [node["target"] for node in each["nodes"]]) for each in found] == [], name

    def press(self) -> None:
        """Hold the hand down for a while, with the pointer."""
        pad = self.page.locator("#hand-pad")
        pad.wait_for()
        box = pad.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + 20.0
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x, y + 0.6 * box["height"], steps=6)


def test_a_person_takes_part(touched: Rig, chromium: Any) -> None:
    with closing(View(touched.environment)) as view, ExperimentBus(DEFAULT_SITE_FILE) as bus:
        runner = Runner(bus)
        context = chromium.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
        person = Person(context.new_page())
        with step("the page before the experiment"):
            person.page.goto(view.participant, wait_until="commit")
            person.page.get_by_text("The experiment has not begun").wait_for()
        cockpit = chromium.new_context(viewport={"width": 1366, "height": 768}).new_page()
        cockpit.goto(view.operator, wait_until="commit")
        runner.start()
        take_part(person, cockpit)
        runner.join(PATIENCE_S)
        assert runner.fault is None
        person.stage("end")
        assert person.faults == []
        compare(touched, runner)
        assert any(answer.values.get("action") == "disturbed" for answer in runner.asked)
        for window in (context, cockpit.context):
            window.close()


def take_part(person: Person, cockpit: Any) -> None:
    page = person.page
    with step("consent"):
        person.stage("consent")
        person.check()
        assert page.locator("#submit").is_disabled()
        page.get_by_label("yes").check()
        page.locator("#submit").click()
    with step("instruction, left by the keyboard, because the button has the focus"):
        person.stage("instruction")
        page.keyboard.press("Enter")
    for index in range(TRIALS + 1):
        with step(f"trial {index}, of which the first is practice"):
            take_trial(person, cockpit, index)
    with step("NASA-TLX, by keyboard, pointer and touch: nothing is chosen before"):
        person.stage("question")
        person.check()
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


def take_trial(person: Person, cockpit: Any, index: int) -> None:
    page = person.page
    if index == 1:
        person.stage("countdown")
    begun = f"Trial {index} of {TRIALS}" if index else "Practice"
    until(lambda: person.begun(begun), f"the trial that is {begun}: {person.faults}")
    if index == 2:
        # a reload in the middle of a trial leads back to it, and says nothing of what was before
        page.reload(wait_until="commit")
        until(lambda: person.begun(begun), f"the trial after a reload: {person.faults}")
    if index == 1:
        page.wait_for_timeout(1200.0)
        person.check()
        experimenter(cockpit)
    person.press()
    page.wait_for_timeout(300.0)
    # the answer that the task is about, while the hand presses
    page.keyboard.press("Space") if index % 2 else page.locator("#during-felt").dispatch_event("click")
    page.mouse.up()


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
repetitions: 2
order: shuffle
practice: {trials: 1}
# a machine with a browser holds processes up: here that is no reason to repeat a trial
disturbed: {stall_s: 5.0}
ask:
  - {instrument: nasa_tlx, after: block}
"""


def test_a_person_does_a_planned_experiment(chromium: Any, tmp_path: Path) -> None:
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
            person.page.context.close()
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
    assert sorted(row["condition"]["law"] for row in rows[1:]) == sorted(LAWS * 2)
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
    while (stage := page.evaluate("document.body?.dataset.stage")) != "end":
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
    """Answer what is on the sheet, if anything is; it may change between a look and another call."""
    page.evaluate("document.querySelector('#go-on:not(:disabled)')?.click()")
    yes = "[...document.querySelectorAll('.option')].find((one) => one.textContent.trim() === 'yes')"
    page.evaluate(f"{yes}?.querySelector('input').click()")
    for name in page.evaluate("[...document.querySelectorAll('input.untouched')].map((scale) => scale.id)"):
        page.evaluate("(name) => document.getElementById(name)?.focus()", name)
        for _ in range(5):
            page.keyboard.press("ArrowRight")
    page.evaluate("document.querySelector('#submit:not(:disabled)')?.click()")


ONE = "afm_node.sample.particles.count=1"
# 1.3 d
BEHIND_M = 4.34e-7
DEEP_MM, WAY_M = 14.0, 1e-6
# This share of half the pad steers at some 130 nm/s.
SHARE = 0.4
# the kinetic friction of latex_250
PLATEAU_N = 10.75e-9


class Pushed:
    """The way of the stage under the force of a particle that slides; each row is read once."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._since_ns, self.way_m = rig, time.time_ns(), 0.0
        self._before = rig.newest("afm/state").base_position_m[:2]

    def follow(self) -> float:
        """Return the way until now [m]."""
        for message in self._rig.recording().messages("afm/state", self._since_ns):
            row, self._since_ns = message.decode(), message.log_ns + 1
            place_m = row.base_position_m[:2]
            if abs(math.hypot(*row.tip_force_n[:2]) - PLATEAU_N) < 0.05 * PLATEAU_N and row.mode == "follow":
                self.way_m += math.dist(place_m, self._before)
            self._before = place_m
        return self.way_m


def done(page: Page, action: Callable[[], object]) -> None:
    """Do something, again where a server that was held up cannot show that it is fresh, which the page says."""
    end = time.monotonic() + PATIENCE_S
    while "acknowledged" not in (answer := page.answered(action)):
        assert "send it again" in answer and time.monotonic() < end, answer


# A particle that is pushed through its middle turns aside by itself: who pushes has to follow the force that is felt,
# by the law of telenano_lab.assembly.particles.steering. The hand does so in the page, at what the page shows, because
# a move of the pointer from outside takes seconds on a busy machine, in which a particle is lost.
HAND = """([share, deep]) => {
  const pad = document.querySelector('#steer-pad'), box = pad.getBoundingClientRect();
  const half = Math.min(box.width, box.height) / 2, steepest = Math.sqrt(3);
  let ahead = [1, 0];
  return setInterval(() => {
    const [x, y] = ['force_x', 'force_y'].map((name) => telenano.store.last('tip', name)), size = Math.hypot(x, y);
    if (size > 5e-9) ahead = [-x / size, -y / size];
    const slope = -Math.max(-steepest, Math.min(steepest, 2 * Math.atan2(-ahead[1], ahead[0])));
    const pull = share / Math.hypot(1, slope);
    const right = pull * (ahead[0] - slope * ahead[1]), up = pull * (slope * ahead[0] + ahead[1]);
    // up on the sample is away from the viewer, and 10 cm of a controller are 10 mm of the hand
    if (deep) return headset.controllers.right.position.set(0.2 + 0.2 * right, 1.2 - deep / 100, -0.4 - 0.2 * up);
    const at = { clientX: box.left + box.width / 2 + half * right, clientY: box.top + box.height / 2 - half * up };
    pad.dispatchEvent(new PointerEvent('pointermove', { pointerId: 1, ...at }));
  }, 100);
}"""


def begin_to_steer(page: Page, share: float) -> int:
    """Hold the pad across with the pointer, pull to the right by a share of its half, and return what ends that."""
    pad = page.page.locator("#steer-pad")
    pad.evaluate("pad => pad.scrollIntoView()")
    box = pad.bounding_box()
    page.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.page.mouse.down()
    return int(page.page.evaluate(HAND, [share, 0.0]))


@pytest.fixture(scope="module")
def assembly(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """Run a rig with one particle, for all tests that move it."""
    with closing(Rig(tmp_path_factory.mktemp("assembly"))) as rig:
        rig.start("--duration", "1800", "--no-view", "--set", ONE, *BESIDE_A_BROWSER, scenario="assembly")
        rig.wait_until(rig.running, "a running session")
        yield rig


@pytest.fixture(scope="module")
def view(assembly: Rig) -> Iterator[View]:
    with closing(View(assembly.environment)) as view:
        yield view


def open_assembly(chromium: Any, view: View, *, headset: bool = False) -> Page:
    page = open_page(chromium, view.operator, headset=headset)
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    page.until("document.querySelector('#assemble') !== null", "the panel of the particles")
    return page


def test_a_hand_in_the_browser_pushes_a_particle_a_micrometre(assembly: Rig, chromium: Any, view: View) -> None:
    page = open_assembly(chromium, view)
    push(assembly, page)
    page.page.context.close()


def push(rig: Rig, page: Page) -> None:
    page.value("document.querySelector('#tab-particles')?.click()")
    # The scene in three dimensions would take most of what the rig leaves of a machine without graphics.
    page.click("#show-flat")
    with step("the tip goes beside the particle"):
        x_m, y_m = ParticlesConfig(count=1).placed(8e-6, 8e-6)[0].tolist()
        # The tip comes from 0, 0, and the particle is not on its way. It goes along x: a push that is a few degrees
        # beside its middle loses it within a micrometre.
        at_x, at_y = x_m - BEHIND_M, y_m
        page.follow()
        page.fill("#tip-x", f"{1e9 * at_x:.3f}")
        page.fill("#tip-y", f"{1e9 * at_y:.3f}")
        done(page, lambda: page.click("#tip-go"))
        rig.wait_until(
            lambda: math.dist(rig.newest("afm/state").base_position_m[:2], (at_x, at_y)) < 1e-9,
            "a tip beside the particle",
        )
    with step("the tip presses, and the particle is pushed"):
        press_deep(rig, page)
        begin_ns, pushed = time.time_ns(), Pushed(rig)
        steering = begin_to_steer(page, SHARE)
        rig.wait_until(lambda: pushed.follow() > WAY_M, "a particle that was pushed a micrometre", PATIENCE_S)
        page.until(has("#particles-state", "Pushing"), "a page that says so")
        page.value(f"clearInterval({steering})")
        rows = rig.recording().messages("haptic/command", begin_ns)
        assert max(math.hypot(*row.decode().force_n[:2]) for row in rows) > 1.0
        page.click("#show-solid")
        page.picture("particles")
    with step("the pointer lets go: the hand is back in its middle, and the tip stands"):
        page.page.mouse.up()
        page.page.wait_for_timeout(1500.0)
        stood = rig.newest("afm/state").base_position_m[:2]
        page.page.wait_for_timeout(1000.0)
        assert rig.newest("afm/state").base_position_m[:2] == stood
    events = [row.decode().data for row in rig.recording().messages("session/event", begin_ns)]
    assert "met" in [event.get("lateral") for event in events]
    assert rig.newest("law/status").passive
    assert page.faults == []


def press_deep(rig: Rig, page: Page) -> None:
    """Press the tip onto the sample with a hand that is kept, so that the pointer is free to steer."""
    page.click("#hand-keep")
    page.press(DEEP_MM)
    page.page.mouse.up()
    rig.wait_until(lambda: rig.newest("afm/state").tip_force_n[2] > 7e-9, "a tip that presses")


# The target lies in the image, because the page draws nothing beyond it.
IMAGED_M, TARGET_M = 1.7e-6, 7.5e-7


def particle_m(rig: Rig) -> tuple[float, float]:
    """Return where the simulated particle really is [m], which the page is not told."""
    (place,) = rig.newest("afm/particles").places_m.to_numpy().tolist()
    return place[0], place[1]


def pushes(rig: Rig, begin_ns: int) -> list[Any]:
    """Return the reports of pushes."""
    rows = [row.decode() for row in rig.recording().messages("afm/program", begin_ns)]
    return [row for row in rows if row.program == "push"]


@pytest.mark.parametrize("headset", [False, True], ids=["by pointer", "in a headset"])
def test_a_program_begins_a_hand_takes_over_and_the_program_ends_it(
    assembly: Rig, chromium: Any, view: View, headset: bool
) -> None:
    page = open_assembly(chromium, view, headset=headset)
    taken_over(assembly, page, headset)
    page.page.context.close()


def imaged(rig: Rig, page: Page) -> None:
    """Take an image of the particle, light enough that it stays, and wait until the page has found it."""
    x_m, y_m = particle_m(rig)
    given = {"x_m": f"{1e9 * x_m:.0f}", "y_m": f"{1e9 * y_m:.0f}", "width_m": f"{1e9 * IMAGED_M:.0f}"}
    given |= {"depth_m": "1200", "pixels": "24", "lines": "10", "dwell_s": "70"}
    given |= {"setpoint_n": "1.5", "approach_m_per_s": "5000"}
    page.value("document.querySelector('#tab-image').click()")
    page.until("document.querySelector('#program-scan-pixels') !== null", "the form of an image")
    for key, value in given.items():
        page.fill(f"#program-scan-{key}", value)
    done(page, lambda: page.click("#program-scan"))
    # The tab Image is shown, from which a person scans.
    page.until("telenano.cockpit.tip.program === 'scan'", "an image that begins")
    rig.wait_until(lambda: rig.newest("afm/program").state == "finished", "the end of the image", 4.0 * PATIENCE_S)
    page.until("!telenano.cockpit.tip.program", "a page that knows of the end")
    page.value("document.querySelector('#tab-particles').click()")
    page.until("document.querySelectorAll('#particles-list li').length === 1", "a particle in the image")


def act(page: Page, button: str, headset: bool) -> None:
    """Press a button of the panel, or the stick of a controller, which does what comes next."""
    if not headset:
        page.click(f"#{button}")
        return
    stick = "headset.controllers.right.updateButtonValue('thumbstick', {})"
    page.value(stick.format(1))
    page.until("telenano.view.headset.isGoing", "a stick that is pressed")
    page.value(stick.format(0))
    page.until("!telenano.view.headset.isGoing", "a stick that was let go")


def drag_target(page: Page, x_nm: float, y_nm: float, to_x_nm: float, to_y_nm: float) -> None:
    """Drag the target of a particle with the pointer in the image from above."""
    page.page.locator("#scene").evaluate("scene => scene.scrollIntoView()")
    page.until("telenano.view.flat.canvas.clientHeight > 0 && telenano.view.flat.frame.scale !== 1", "the flat image")
    at = "(({{left, top}}, [x, y]) => [left + x, top + y])(flat.canvas.getBoundingClientRect(), flat.toCanvas("
    at = f"(flat => {at}telenano.view.surface.extent, {{}}, {{}})))(telenano.view.flat)"
    mouse = page.page.mouse
    mouse.move(*page.value(at.format(x_nm, y_nm)))
    mouse.down()
    mouse.move(*page.value(at.format(to_x_nm, to_y_nm)), steps=4)
    mouse.up()


def point_target(page: Page, x_nm: float, y_nm: float, to_x_nm: float, to_y_nm: float) -> None:
    """Drag the target of a particle with the trigger of the left controller, held over the table and pointing down."""
    left = "headset.controllers.left"
    page.value(f"{left}.quaternion.set(-Math.SQRT1_2, 0, 0, Math.SQRT1_2)")
    over = "(at => {left}.position.set(at.x, at.y + 0.2, at.z))(telenano.view.world.localToWorld({vector}))"
    for number, (x, y) in enumerate(((x_nm, y_nm), (to_x_nm, to_y_nm))):
        page.value(over.format(left=left, vector=f"telenano.view.world.position.clone().set({x}, {y}, 0)"))
        drawn = page.value("telenano.view.frames")
        page.until(f"telenano.view.frames > {drawn} + 2", "a controller that has moved")
        page.value(f"{left}.updateButtonValue('trigger', {1 - number})")
        page.until(f"{'!' * (1 - number)}!telenano.view.headset.dragged", "a target in the hand, and let go")


TRIGGER = "headset.controllers.right.updateButtonValue('trigger', {})"


def begin_in_headset(rig: Rig, page: Page) -> int:
    """Hold tip and stylus by the right controller, press, pull to the right, and return what ends that."""
    page.value("headset.controllers.right.position.set(0.2, 1.2, -0.4)")
    page.value(TRIGGER.format(1))
    page.until("telenano.view.headset.pressed", "a trigger that is held")
    page.value(f"headset.controllers.right.position.set(0.2, {1.2 - 1e-2 * DEEP_MM}, -0.4)")
    rig.wait_until(lambda: rig.newest("afm/state").tip_force_n[2] > 7e-9, "a tip that presses")
    return int(page.page.evaluate(HAND, [SHARE, DEEP_MM]))


def take_over(rig: Rig, page: Page, headset: bool) -> None:
    """Take over, again where a server that was held up has refused it, which the panel says."""
    end = time.monotonic() + PATIENCE_S
    while True:
        act(page, "take-over", headset)
        said = "document.querySelector('#particles-state').textContent"
        page.until(f"/By hand|take over again/.test({said})", "what comes of taking over")
        if "By hand" in page.value(said):
            break
        assert time.monotonic() < end, page.page.inner_text("#answers")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "a tip that follows the hand")


def keys_choose(page: Page) -> None:
    """Change by the key k what the hand across is, and back."""
    for mode in ("position", "rate"):
        done(page, lambda: page.page.keyboard.press("k"))
        assert page.value("document.querySelector('#lateral-mode').value") == mode


def taken_over(rig: Rig, page: Page, headset: bool) -> None:
    if not headset:
        page.click("#show-flat")
    with step("an image of the particle, light enough that it stays"):
        before = particle_m(rig)
        imaged(rig, page)
        assert math.dist(before, particle_m(rig)) < 1e-9
    with step("a target for it"):
        goal = before[0] + TARGET_M, before[1]
        begin_ns = time.time_ns()
        if headset:
            page.until("!document.querySelector('#vr').hidden", "a browser with a headset")
            page.click("#vr")
            shown = "telenano.view.headset.isPresenting && telenano.view.sheet.mesh.visible"
            page.until(shown, "circles in the headset")
        (point_target if headset else drag_target)(page, *(1e9 * value for value in (*before, *goal)))
        page.until("/from its target/.test(document.querySelector('#particles-list li').textContent)", "a target")
    with step("the program pushes, and the hand takes over"):
        done(page, lambda: act(page, "assemble", headset))
        rig.wait_until(lambda: particle_m(rig)[0] - before[0] > 1e-7, "a particle that the program pushes")
        take_over(rig, page, headset)
        assert pushes(rig, begin_ns)[-1].state == "ended"
        middle = particle_m(rig)
        assert middle[0] - before[0] < TARGET_M - 2e-7
    with step("the hand pushes"):
        if headset:
            steering = begin_in_headset(rig, page)
        else:
            keys_choose(page)
            press_deep(rig, page)
            steering = begin_to_steer(page, SHARE)
        pushed = lambda: math.dist(particle_m(rig), middle) > 1e-7  # noqa: E731
        rig.wait_until(pushed, "a particle that the hand has pushed", PATIENCE_S)
        page.value(f"clearInterval({steering})")
        if headset:
            page.value(TRIGGER.format(0))
            page.until("!telenano.view.headset.pressed", "a trigger that was let go")
        else:
            page.page.mouse.up()
    with step("the program ends what it began"):
        by_hand_ns = time.time_ns()
        done(page, lambda: act(page, "give-back", headset))
        rig.wait_until(lambda: pushes(rig, by_hand_ns) != [], "a push that goes on")
        rig.wait_until(lambda: pushes(rig, by_hand_ns)[-1].state == "finished", "the end of the push")
        assert pushes(rig, by_hand_ns)[-1].values["why"] == AT_GOAL
        # The truth of a particle that rests comes once a second.
        rig.wait_until(lambda: math.dist(particle_m(rig), goal) < 50e-9, "a particle at its goal")
        page.until("!telenano.cockpit.tip.program", "a page that knows")
        page.click("#show-solid")
    assert page.faults == []


def transport(page: Page, action: str, value: float) -> None:
    page.value(f"telenano.cockpit.commands.ask('{action}', {{ k: 'transport', action: '{action}', value: {value} }})")


def contact_s(path: Path) -> float:
    """Return when a push has met its particle, from the begin of a recording [s]."""
    found = Recording(path)
    met = [row for row in found.messages(("afm/program",)) if (row.fields().get("values") or {}).get("in_contact")]
    return 1e-9 * (met[0].log_ns - found.span_ns[0])


def test_the_recording_of_an_assembly_shows_it_again(chromium: Any, tmp_path: Path) -> None:
    (tmp_path / "there.txt").write_text("4e-7 1e-7\n")
    one = ("--afm", "sample.particles.places=[[0.0,0.0]]", "--afm", "sample.size_m=3e-6")
    out = tmp_path / "out"
    words = ["assemble", "--pattern", str(tmp_path / "there.txt"), "--out", str(out), "--json", *one]
    subprocess.run([sys.executable, "-m", "telenano", *words], check=True, capture_output=True)
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(tmp_path)}
    with closing(View(environment, str(out / "assembly.mcap"))) as view:
        page = open_page(chromium, view.operator)
        page.until("document.querySelector('#particles-list') !== null", "the panel of the particles")
        page.value("document.querySelector('#tab-particles')?.click()")
        page.click("#show-flat")
        drawn = page.value("telenano.view.frames")
        transport(page, "rate", 10.0)
        page.until("document.querySelectorAll('#particles-list li').length === 1", "a particle in the first image")
        # A push takes half a second, which a page without a graphics processor draws a few times of.
        transport(page, "rate", 0.05)
        transport(page, "seek", contact_s(out / "assembly.mcap"))
        transport(page, "play", 0.0)
        page.until("/, pushed/.test(document.querySelector('#particles-list li').textContent)", "the push")
        transport(page, "rate", 10.0)
        # 400 and 100 nm, and the drift meanwhile
        at_goal = "(() => { const [x, y] = document.querySelector('#particles-list li').textContent.split(/[, ]+/)"
        page.until(f"{at_goal}; return Math.hypot(x - 400, y - 100) < 40; }})()", "the particle at its goal")
        # the scene is not drawn while only the flat image is shown
        assert page.value("telenano.view.frames") == drawn
        page.click("#show-solid")
        page.until("telenano.view.sheet.mesh.visible", "circles in three dimensions")
        assert page.faults == []
        page.page.context.close()
