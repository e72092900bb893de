"""Trials on a rig of processes that stays up: the condition changes while the hand is at rest, and is verified.

Before each trial the link is clean while a simulated hand returns to its start and the law changes bumplessly; then the
link takes its condition. The trial begins only when `link/status` and `link/delay` report the settings and the delay,
`law/status` the law at both halves, and `node/health` that every node runs. Each trial is an MCAP file of its own: the
recorder begins a new file after it.
"""

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from pathlib import Path
from typing import Any, Literal

from telenano.console import holding, recouple, send_control
from telenano.recording import Recording
from telenano.runtime import AddressBook, Command, Observer
from telenano.sections import ControllerConfig, HapticConfig
from telenano.settings import DEFAULT_SITE_FILE, LinkSettings
from telenano.wire import (
    LINK,
    AfmState,
    HapticState,
    LinkDelay,
    LinkStatus,
    Message,
    NodeHealth,
    RecordingError,
    RigError,
    Scalar,
)
from telenano_lab.experiments.apparatus.base import Apparatus, Course, Take
from telenano_lab.experiments.apparatus.marks import END, Marks, code_of
from telenano_lab.experiments.apparatus.page_hand import PageHand
from telenano_lab.experiments.apparatus.rig_process import RigProcess, wait_for_others
from telenano_lab.experiments.apparatus.wanted import (
    NO_HAND,
    WantedSettings,
    constant_delays_ns,
    kept_keys,
    of_way,
    section_of,
    wanted_of,
)
from telenano_lab.experiments.desk import Desk
from telenano_lab.experiments.disturbances import disturbances
from telenano_lab.experiments.nodes import HAND, RECORDER, TIP
from telenano_lab.experiments.plan import Plan, parameters_of
from telenano_lab.experiments.recorded_trial import RecordedTrial
from telenano_lab.experiments.types import Trial

_HALVES = ("controller@master", "controller@slave")
_REPORTS = ("link/status", "link/delay", "law/status", "node/health")
_NODES = (HAND, *_HALVES, f"{LINK}@master", TIP, RECORDER)
# Longest wait for a state [s]; the rig's own deadlines are far shorter.
_PATIENCE_S = 20.0
_LISTEN_S = 0.05
# The hand is at rest below this speed.
_REST_M_PER_S = 2e-4
# The hand must be at rest, or at its start, for this time.
_REST_S = 0.1
# The hand is at its start within this distance of it.
_HOME_M = 2e-4
# Longest time for the hand to return to its start.
_HOME_S = 6.0
# Longest time for the hand to come to rest.
_REST_MOST_S = 6.0
_CLEAN: dict[str, Scalar] = {"profile": "clean"}
# Messages under way at the end of the force profile still belong to the trial.
_AFTER_S = 0.3
# Hand and tip are coupled if the base is within this distance of the place of the hand, at the scale of the law [m].
_SAME_PLACE_M = 2e-9
# Number of attempts to couple them before the trial is given up.
_COUPLINGS = 3
_NO_MARKS: Mapping[int, int | str] = {}


_Name = Literal["start", "stop", "set", "mark", "arm"]


class Live(Apparatus):
    """An apparatus of processes on this machine.

    Args:
        plan: The experiment.
        folder: The folder of the experiment.
        desk: Communicates with participant and experimenter.
        show: Called with messages for a person.
        marks: The port on which trials are marked; None for none.
    """

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        desk: Desk,
        show: Callable[[str], None] = lambda text: None,
        marks: Marks | None = None,
    ) -> None:
        super().__init__(plan, desk)
        self._folder, self._show, self._marks = folder.resolve(), show, marks
        self._site_file = DEFAULT_SITE_FILE
        self._rig: RigProcess | None = None
        self._kept = ""
        self._set = WantedSettings({}, {}, "", {}, {})
        self._document: Mapping[str, Any] = {}
        # At the beginning of the trial: places of hand and base, and offset of the base from that of the hand [m].
        self._place_m, self._base_m, self._apart_m = 0.0, 0.0, 0.0
        # A simulated hand that steers the tip acts like a page.
        self._page: PageHand | None = None
        self._hold = ExitStack()
        self._lease: Any = None
        self._was_lost = False
        self._observer: Observer | None = None
        # The newest report by topic and source, with its time of arrival.
        self._newest: dict[tuple[str, str], tuple[float, Message]] = {}
        wait_for_others(self._folder, show)

    def close(self) -> None:
        self._hold.close()
        self._lease = None
        if self._observer is not None:
            self._observer.close()
            self._observer = None
        if self._page is not None:
            self._page.close()
            self._page = None
        if self._rig is not None:
            self.desk.detach()
            self._rig.end()
            self._rig = None

    def take(self, course: Course) -> Take:
        trial = course.trial
        wanted, self._was_lost = wanted_of(course.document, trial.seed), False
        rig = self._rig_in(trial, course.document, wanted)
        verified = self._verified(wanted)
        place = f"t{trial.index:04d}-{course.attempt}" + (f"-{course.interval}" if course.intervals > 1 else "")
        mark: dict[str, Scalar] = {"trial": trial.index, "attempt": course.attempt, "interval": course.interval}
        # The part before the trial is in a file of its own, which is of no use.
        self._split(rig).unlink()
        self._command("mark", RECORDER, {**mark, "state": "begin", "task": trial.task, "phase": trial.phase})
        self.desk.begin(trial, course.attempt, first=course.interval == 0)
        marked: dict[int, int | str] = {}
        with self._pushing(course):
            self._command("start", HAND)
            begun_s = time.monotonic()
            self._mark(code_of(self.plan, trial), marked)
            try:
                answers = list(self._wait(course.duration_s, begun_s))
            finally:
                self._command("stop", HAND)
                self._mark(END, marked)
        self._watch(_AFTER_S)
        self._command("mark", RECORDER, {**mark, "state": "end"})
        path = self._folder / "recordings" / trial.participant / f"{place}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        self._split(rig).replace(path)
        # The hand comes to rest while the trial is judged.
        self._command("set", LINK, _CLEAN)
        return self._judged(course, path, verified, answers, marked)

    def _mark(self, code: int, marked: dict[int, int | str]) -> None:
        """Mark the trial, and store the time [ns], or the reason of a failure, which counts as a disturbance."""
        if self._marks is not None:
            try:
                marked[code] = self._marks.send(code)
            except RigError as error:
                marked[code] = str(error)

    def document(self, trial: Trial, parameters: Any, interval: Mapping[str, Any]) -> dict[str, Any]:
        document, hand = super().document(trial, parameters, interval), self.simulated(trial)
        if hand is not None and hand.steers(self.plan.tasks[trial.task], parameters, trial.seed):
            document["haptic_node"] = {**document["haptic_node"], "operator": {"kind": "interactive"}}
        return document

    def _pushing(self, course: Course) -> AbstractContextManager[None]:
        """Let the simulated hand of a course push through the page's interface, if it steers the tip laterally."""
        steers = self.steering(course)
        if steers is None:
            return nullcontext()
        if self._page is None:
            self._page = PageHand(self._site_file)
        hand = section_of(course.document, "haptic_node", HapticConfig).lateral_in_force
        return self._page.pushing(
            steers, section_of(course.document, "controller", ControllerConfig), hand.stiffness_n_per_m
        )

    def _judged(
        self,
        course: Course,
        path: Path,
        verified: dict[str, Any],
        answers: list[Mapping[str, Any]],
        marked: Mapping[int, int | str] = _NO_MARKS,
    ) -> Take:
        name = str(path.relative_to(self._folder))
        try:
            recorded = RecordedTrial(path)
        except RecordingError as error:
            return Take(None, f"the recording cannot be read: {error}", name, verified)
        band = section_of(course.document, "controller", ControllerConfig).deadband
        evidence = recorded.evidence(course.duration_s, band.keep_alive_s if band.enabled else 0.0)
        reasons = [what for what in marked.values() if isinstance(what, str)]
        reasons += ["the experiment stood still for a second and lost the hand"] if self._was_lost else []
        reasons += disturbances(evidence, self.plan.experiment.disturbed.stall_s)
        for code, sent_ns in marked.items():
            if not isinstance(sent_ns, str):
                verified[f"mark_{code}_s"] = round(1e-9 * (sent_ns - recorded.start_ns), 6)
        if recorded.duration_s < 0.9 * course.duration_s:
            reasons.append(f"it lasted {recorded.duration_s:.2f} s instead of {course.duration_s:.2f} s")
        timed = [{**answer, "time_s": 1e-9 * (answer["given_ns"] - recorded.start_ns)} for answer in answers]
        answered = ({key: answer[key] for key in ("name", "value", "time_s")} for answer in timed)
        data = recorded.data(course.duration_s, answered)
        if not data.afm["time_s"].size:
            return Take(None, "; ".join([*reasons, "its recording has no state of the tip"]), name, verified)
        return Take(data, "; ".join(reasons), name, verified)

    def prepare(self, trial: Trial) -> None:
        parameters = parameters_of(self.plan.tasks[trial.task], trial.task_parameters)
        first = self.plan.tasks[trial.task].intervals(parameters, trial.seed)[0]
        self._rig_of(trial, self.document(trial, parameters, first.settings))

    def _rig_of(self, trial: Trial, document: Mapping[str, Any]) -> RigProcess:
        """Return the rig of a trial: the running one, or a new one if they differ in keys that need a restart.

        Each participant has separate rigs, so that all of a participant's data are in separate folders.
        """
        kept = json.dumps([trial.participant, kept_keys(document)], sort_keys=True)
        self._document = document
        if self._rig is not None and kept == self._kept:
            self._rig.check()
            return self._rig
        self.close()
        parent = self._folder / "rig"
        number = len(list(parent.glob(f"{trial.participant}-*"))) + 1
        folder = parent / f"{trial.participant}-{number}"
        hand = document.get("haptic_node", {})
        # No simulated hand presses before the first trial; a page's force is zero until then.
        operator = hand.get("operator", NO_HAND)
        if self.simulated(trial) is not None and operator.get("kind") != "interactive":
            operator = NO_HAND
        started = {**document, "haptic_node": {**hand, "operator": operator}}
        is_person = self.plan.experiment.operator.kind == "person"
        self._show(f"starting the rig of {trial.participant}")
        # While the experiment has control, participants press and nobody else commands.
        self._lease = self._hold.enter_context(holding("experiment"))
        self._rig = RigProcess(folder, started, () if is_person else ("--headless",), self._show)
        self._kept, self._newest = kept, {}
        self._set = wanted_of(started, trial.seed)._replace(operator="", link={})
        self._observer = Observer(AddressBook.load(self._site_file), _REPORTS)
        self._await_running(self._rig)
        self._command("stop", HAND)
        self.desk.attach(self._site_file)
        return self._rig

    def _await_running(self, rig: RigProcess) -> None:
        """Wait until the session of a new rig runs: its devices are armed and the hand's session clock counts."""
        deadline_s = time.monotonic() + 4.0 * _PATIENCE_S
        with closing(Observer(AddressBook.load(self._site_file), ("haptic/state",))) as observer:
            while time.monotonic() < deadline_s:
                rig.check()
                for observed in observer.listen(_LISTEN_S):
                    state = observed.received.message
                    if isinstance(state, HapticState) and state.session_s >= 0.0:
                        return
        raise RigError(f"the rig did not begin its session; see {rig.folder}")

    def _rig_in(self, trial: Trial, document: Mapping[str, Any], wanted: WantedSettings) -> RigProcess:
        """Return a rig in a condition, with hand and tip coupled as in a new one.

        A law keeps the places at which it was coupled, and a gap in the messages can shift them against each other:
        then the tip is withdrawn and armed again. If that fails, a simulated hand gets a new rig, and a person's hand
        another try.
        """
        for left in reversed(range(_COUPLINGS)):
            rig = self._rig_of(trial, document)
            self._ready()
            self._rest(wanted)
            if abs(off_m := self._off_m(document)) <= _SAME_PLACE_M:
                break
            self._show(f"the tip is {1e9 * off_m:.1f} nm from where the hand has it: both are coupled again")
            try:
                self._couple()
            except RigError as error:
                if not left:
                    raise
                self._show(str(error))
                if wanted.operator:
                    self._show("the rig is restarted")
                    self.close()
                continue
            # Some laws, such as tactile, do not bring the tip to the place of the hand: the remaining offset is
            # recorded.
            self._off_m(document)
            break
        self._prepare_sample(document)
        self._condition(wanted)
        return rig

    def _off_m(self, document: Mapping[str, Any]) -> float:
        """Return the offset of the base from the place of the hand at the scale of the law [m]."""
        law = section_of(document, "controller", ControllerConfig).law_config()
        states = self._states()
        self._base_m = -states["afm/state"].base_position_m[2]
        self._apart_m = float(self._base_m + law.position_scale * states["haptic/state"].position_m[2])
        return self._apart_m

    def _couple(self) -> None:
        """Couple hand and tip again, as `telenano session couple` does; withdraw the tip first if it touches."""
        if self._states()["afm/state"].in_contact:
            self._command("stop", TIP)
            self._await_tip(lambda state: not state.in_contact, "that the tip is withdrawn")
        self._show(recouple(self._site_file))

    def _prepare_sample(self, document: Mapping[str, Any]) -> None:
        """Move a laterally steered tip to its start over the sample, and restore the particles' first places."""
        across = section_of(document, "controller", ControllerConfig).lateral
        if "lateral" not in document.get("haptic_node", {}) or across.mode == "direct":
            return
        # In position mode the tip follows the hand, which continues from where it is.
        scale = across.position_scale if across.mode == "position" else 0.0
        x_m, y_m = (scale * place_m for place_m in self._states()["haptic/state"].position_m[:2])

        def put() -> None:
            self._command("set", TIP, {"lateral.x_m": x_m, "lateral.y_m": y_m})

        def is_there(state: AfmState) -> bool:
            return math.dist(state.base_position_m[:2], (x_m, y_m)) <= _SAME_PLACE_M

        # A hand not yet at rest laterally controls the stage and keeps the tip in place: the command is repeated.
        self._await_tip(is_there, "that the tip is at its place over the sample", put)
        if "particles" in document.get("afm_node", {}).get("sample", {}):
            self._command("set", TIP, {"sample.restore": True})

    def _await_tip(self, is_so: Callable[[AfmState], bool], what: str, ask: Callable[[], None] = lambda: None) -> None:
        """Wait until a condition holds for the tip; `ask` is called before each look."""
        deadline_s = time.monotonic() + _PATIENCE_S
        ask()
        while not is_so(self._states()["afm/state"]):
            if time.monotonic() >= deadline_s:
                raise RigError(f"the rig did not report {what} within {_PATIENCE_S:g} s")
            ask()

    def _ready(self) -> None:
        """Arm devices that an earlier condition has stopped; an emergency stop is left to a person."""
        states = self._states()
        if states["haptic/state"].estop or states["afm/state"].mode == "estop":
            raise RigError(
                "a device is in emergency stop: find out why, and continue with `telenano experiment resume`"
            )
        if states["afm/state"].mode not in ("follow", "hold"):
            self._command("set", LINK, _CLEAN)
            self._send(Command("arm", TIP, parameters={"place": "hand"}, placed=True))

    def _states(self) -> dict[str, Any]:
        """Return the newest state of both devices."""
        states: dict[str, Any] = {}
        with closing(Observer(AddressBook.load(self._site_file), ("haptic/state", "afm/state"))) as observer:
            for observed in observer.listen(_PATIENCE_S):
                states[observed.received.topic] = observed.received.message
                if len(states) == 2:
                    return states
        raise RigError("the devices of the rig are silent; see the logs in its folder")

    def _rest(self, wanted: WantedSettings) -> None:
        """Bring the hand to its start and to rest over a clean link, and change the law."""
        before = self._set
        self._place_m = self._go_home() if wanted.operator else self._await_rest()
        for target, new, old in (
            ("controller", wanted.law, before.law),
            (HAND, wanted.hand, before.hand),
            (TIP, wanted.tip, before.tip),
        ):
            if changes := {key: value for key, value in new.items() if old.get(key) != value}:
                self._command("set", target, changes)
        self._watch_until(lambda: self._law_is(str(wanted.law["law"])), f"the law {wanted.law['law']} at both halves")

    def _condition(self, wanted: WantedSettings) -> None:
        """Set the force profile of the operator and the condition of the link."""
        if wanted.operator:
            self._command("set", HAND, {"operator": wanted.operator})
        self._command("set", LINK, {**wanted.link})
        self._set = wanted

    def _go_home(self) -> float:
        """Move a simulated hand back to its start; return its place then [m]."""
        start_m = self._start_m
        path = [{"time_s": 0.0, "position_m": start_m}]
        self._command("set", HAND, {"operator": json.dumps({"kind": "impedance", "path": path, "arm": "ordinary"})})
        self._command("start", HAND)
        try:
            self._await_hand(lambda state: abs(-state.position_m[2] - start_m) <= _HOME_M, _HOME_S)
        finally:
            self._command("stop", HAND)
        return self._await_rest()

    @property
    def _start_m(self) -> float:
        return float(section_of(self._document, "haptic_node", HapticConfig).device.start_position_m)

    def _await_rest(self) -> float:
        return self._await_hand(lambda state: abs(state.velocity_m_per_s[2]) < _REST_M_PER_S, _REST_MOST_S)

    def _await_hand(self, is_there: Callable[[HapticState], bool], most_s: float) -> float:
        """Wait, at most most_s, until a condition has held for the hand for a while; return its place then [m]."""
        since_ns: int | None = None
        place_m = 0.0
        with closing(Observer(AddressBook.load(self._site_file), ("haptic/state",))) as observer:
            for observed in observer.listen(most_s):
                state = observed.received.message
                if not isinstance(state, HapticState):
                    continue
                place_m = -state.position_m[2]
                if not is_there(state):
                    since_ns = None
                    continue
                since_ns = state.t_ns if since_ns is None else since_ns
                if state.t_ns - since_ns >= _REST_S * 1e9:
                    break
        return place_m

    def _verified(self, wanted: WantedSettings) -> dict[str, Any]:
        """Wait until the rig reports the condition; return its reports, or raise RigError naming the missing one."""
        expected = {way: of_way(wanted.link, way) for way in ("forward", "backward")}
        network = LinkSettings().changed(wanted.link).network_name

        def link_is_set() -> bool:
            status = self._report("link/status", f"{LINK}@master")
            return isinstance(status, LinkStatus) and all(
                getattr(status, way).profile == network and dict(getattr(status, way).settings) == keys
                for way, keys in expected.items()
            )

        self._watch_until(link_is_set, "the settings of the link")
        delays = constant_delays_ns(wanted.link)
        self._watch_until(
            lambda: all(self._delay_ns(way) == delay_ns for way, delay_ns in delays.items()), f"the delays {delays} ns"
        )
        self._watch_until(lambda: self._law_is(str(wanted.law["law"])), f"the law {wanted.law['law']}")
        self._watch_until(lambda: not self._absent(), "every node")
        status = self._report("link/status", f"{LINK}@master")
        assert isinstance(status, LinkStatus)
        return {
            "law": wanted.law["law"],
            "profile": status.forward.profile,
            "link_seed": wanted.link.get("seed"),
            **{f"{way}.{key}": value for way, keys in expected.items() for key, value in keys.items()},
            **{f"{way}_delay_ns": self._delay_ns(way) for way in expected},
            "hand_start_m": round(self._place_m, 7),
            "base_start_m": round(self._base_m, 12),
            "apart_start_m": round(self._apart_m, 12),
            "nodes": len(_NODES),
        }

    def _delay_ns(self, way: str) -> int | None:
        delays = [
            message
            for (topic, _), (_, message) in self._newest.items()
            if topic == "link/delay" and isinstance(message, LinkDelay) and message.direction == way
        ]
        return delays[-1].delay_ns if delays else None

    def _law_is(self, law: str) -> bool:
        reports = [self._report("law/status", half) for half in _HALVES]
        return all(report is not None and report.law == law and not report.switching for report in reports)

    def _absent(self) -> list[str]:
        """Return the nodes that report nothing, or report that they are not running."""
        reports = {node: self._report("node/health", node) for node in _NODES}
        return [node for node, report in reports.items() if report is None or report.state in ("stopping", "starting")]

    def _report(self, topic: str, src: str) -> Any:
        """Return the newest report; None if none came since the last command or it is too old."""
        at_s, message = self._newest.get((topic, src), (0.0, None))
        fresh_s = 2.0 if topic == "node/health" else 1.0
        return message if time.monotonic() - at_s <= fresh_s else None

    def _watch_until(self, is_so: Callable[[], bool], what: str) -> None:
        deadline_s = time.monotonic() + _PATIENCE_S
        while not is_so():
            if time.monotonic() >= deadline_s:
                raise RigError(f"the rig did not report {what} within {_PATIENCE_S:g} s")
            self._watch(_LISTEN_S)

    def _watch(self, duration_s: float) -> None:
        """Receive the reports of the rig for a time [s]."""
        assert self._observer is not None
        for observed in self._observer.listen(duration_s):
            message = observed.received.message
            way = f" {message.direction}" if isinstance(message, LinkDelay) else ""
            if not (isinstance(message, NodeHealth) and "@" in observed.name):
                self._newest[observed.received.topic, message.src + way] = (time.monotonic(), message)
        if self._rig is not None:
            self._rig.check()

    def _wait(self, duration_s: float, begun_s: float) -> Iterator[Mapping[str, Any]]:
        """Wait for the end of a trial, and yield the answers that come meanwhile."""
        while (elapsed_s := time.monotonic() - begun_s) < duration_s:
            self._watch(min(_LISTEN_S, duration_s - elapsed_s))
            yield from self.desk.during(elapsed_s)

    def _command(self, name: _Name, target: str, parameters: Mapping[str, Scalar] | None = None) -> None:
        """Send a command and drop earlier reports; RigError if a node refuses it."""
        self._send(Command(name, target, parameters=parameters or {}))

    def _send(self, command: Command) -> None:
        self._keep_hand()
        answers = send_control(command, self._site_file, "master", lambda event: None)
        refused = [f"{src}: {event.text}" for src, event in sorted(answers.items()) if event.kind == "refused"]
        if refused:
            raise RigError(f"{command.name} {command.target}: {'; '.join(refused)}")
        self._newest = {}

    def _keep_hand(self) -> None:
        """Take control of the hand again if a stall of the machine has lost it, which disturbs the trial.

        Raises:
            RefusedError: Another client has it now; the message names it.
        """
        if self._lease is None or self._lease.is_held():
            return
        self._hold.close()
        self._lease, self._was_lost = self._hold.enter_context(holding("experiment")), True
        self._show("the experiment stood still for a second and lost the hand: it has taken it again")

    def _split(self, rig: RigProcess) -> Path:
        """Make the recorder begin a new file; return the finished one."""
        finished = rig.recordings[-1]
        self._command("set", RECORDER, {"record.split": True})
        deadline_s = time.monotonic() + _PATIENCE_S
        while not Recording(finished).closed:
            if time.monotonic() >= deadline_s:
                raise RigError(f"{finished}: the recorder did not end the file")
            self._watch(_LISTEN_S)
        return finished
