"""The runner of the instrument's programs: what it begins, changes, ends and reports, with a program made for it."""

from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from telenano.afm import safety
from telenano.afm.programs.runner import ProgramRunner, RunnerState
from telenano.extend.programs import Begun, Inputs, Instrument, Program, Progress, Wanted
from telenano.extend.samples import Oscillation
from telenano.extend.stage import Place
from telenano.sections.program_table import PROGRAMS
from telenano.settings.config import Settings
from telenano.wire.errors import RefusedError

HERE, THERE = Place(1e-9, 2e-9), Place(3e-9, 4e-9)
INPUTS = Inputs(-5e-9, HERE, 0.0, (0.0, 0.0), Oscillation(0.0, 0.0), HERE)
DT = 1e-3


class Counted(NamedTuple):
    """How far the program below goes."""

    steps: int
    begun_at: Place


class Count(NamedTuple):
    """How far it is, and how often it was told to stand."""

    step: int
    paused: int


class Counting(Program[Settings, Counted, Count]):
    """Counts its steps, four of them; the second warns, and so does the third."""

    settings = Settings
    title, about = "Count", "Counts."
    can_pause = True

    def begin(self, settings: Any, instrument: Instrument, place: Place) -> Begun[Counted, Count]:
        return Begun(Counted(settings, place), Count(0, 0), "it counts", "be careful")

    def step(self, plan: Counted, state: Count, inputs: Inputs, dt: float) -> Wanted[Count]:
        if inputs.is_paused:
            return Wanted(state._replace(paused=state.paused + 1), inputs.base_m, inputs.place)
        step = state.step + 1
        notice = f"warning {step}" if step in (2, 3) else ""
        return Wanted(Count(step, state.paused), step * 1e-9, THERE, step >= plan.steps, None, 7e-9, notice)

    def progress(self, plan: Counted, state: Count) -> Progress:
        return Progress(f"step {state.step}", state.step / plan.steps, state.step, plan.steps)


class Searching(Counting):
    """Looks for a surface for as long as its steps say [s], and may for one second."""

    label = "long search"
    can_pause = False

    def searching_s(self, plan: Counted, state: Count) -> tuple[float, float]:
        return 0.5 * state.step, 1.0

    def shortfall(self, plan: Counted, state: Count) -> str:
        return " but for one point"


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch) -> ProgramRunner:
    for name, program in (("count", Counting()), ("search", Searching())):
        monkeypatch.setitem(PROGRAMS, name, program)
    return ProgramRunner(instrument(), PROGRAMS)


def instrument() -> Instrument:
    limits: Any = SimpleNamespace(base_max_m=2e-6)
    return Instrument(limits, None, (1e-6, 1e-6), 1.0, DT)


def ask(
    runner: ProgramRunner, wanted: str, steps: int = 4, *, mode: int = safety.MODE_RETRACTED, device_lost: bool = False
) -> str:
    asked: Any = SimpleNamespace(program=wanted, settings_of={wanted: steps}.__getitem__)
    return runner.request(asked, mode, HERE, device_lost=device_lost)


def test_before_the_first_program_nothing_runs_and_nothing_can_be_changed(runner: ProgramRunner) -> None:
    assert (runner.name, runner.state, runner.take_notice()) == ("", "finished", "")
    assert runner.capture() == RunnerState("", "finished", "", "", None, None)
    for change in ("pause", "resume", "abort"):
        with pytest.raises(RefusedError, match=f"^program: no program runs, so there is nothing to {change}$"):
            ask(runner, change)


def test_a_program_begins_with_its_settings_where_the_tip_is_and_warns_once(runner: ProgramRunner) -> None:
    assert ask(runner, "count", 3) == "it counts"
    assert (runner.name, runner.state) == ("count", "running")
    assert (runner.take_notice(), runner.take_notice()) == ("be careful", "")
    plan = runner.capture().plan
    assert plan is not None
    assert plan.values == Counted(3, HERE)


def test_each_step_is_asked_of_the_guard_until_the_last_which_retracts(runner: ProgramRunner) -> None:
    ask(runner, "count", 2)
    action, wanted = runner.step(INPUTS, DT)
    assert (action, wanted.base_m, wanted.place, wanted.amplitude_m) == (safety.ACTION_POSITION, 1e-9, THERE, 7e-9)
    assert not runner.is_over
    assert runner.report() == ("count", "running", "step 1", 50.0, 1, 2, None)
    for mode in (safety.MODE_FOLLOW, safety.MODE_HOLD):
        runner.follow_guard(mode, safety.REASON_ARMED)
        assert runner.state == "running"
    action, wanted = runner.step(INPUTS, DT)
    assert (action, wanted.base_m) == (safety.ACTION_RETRACT, 2e-9)
    runner.follow_guard(safety.MODE_RETRACTING, safety.REASON_RETRACT_REQUESTED)
    assert runner.report() == ("count", "finished", "the count is finished: the tip retracts", 100.0, 2, 2, None)
    assert runner.is_over
    runner.end()
    assert (runner.name, runner.capture().plan, runner.capture().reached) == ("", None, None)
    assert ask(runner, "count") == "it counts"


def test_of_two_warnings_the_first_is_kept_until_it_is_taken(runner: ProgramRunner) -> None:
    ask(runner, "count")
    for _ in range(3):
        runner.step(INPUTS, DT)
    assert runner.take_notice() == "be careful"
    ask_again = ProgramRunner(instrument(), PROGRAMS)
    ask(ask_again, "count")
    ask_again.take_notice()
    for _ in range(3):
        ask_again.step(INPUTS, DT)
    assert (ask_again.take_notice(), ask_again.take_notice()) == ("warning 2", "")


def test_a_program_that_can_pause_is_told_so_and_goes_on(runner: ProgramRunner) -> None:
    ask(runner, "count")
    runner.step(INPUTS, DT)
    assert ask(runner, "pause") == "the count is paused"
    for _ in range(2):
        runner.step(INPUTS, DT)
    assert runner.report()[1:3] == ("paused", "step 1")
    assert ask(runner, "resume") == "the count is running"
    runner.step(INPUTS, DT)
    reached = runner.capture().reached
    assert reached is not None
    assert reached.values == Count(2, 2)


def test_one_that_cannot_is_left_running(runner: ProgramRunner) -> None:
    ask(runner, "search")
    with pytest.raises(RefusedError, match=r"^program: a search cannot pause, it can only be aborted$"):
        ask(runner, "pause")
    assert runner.state == "running"


def test_an_aborted_program_takes_no_step_more_and_the_tip_retracts(runner: ProgramRunner) -> None:
    ask(runner, "search")
    assert ask(runner, "abort") == "the long search ends and the tip retracts"
    before = runner.capture().reached
    assert runner.step(INPUTS, DT) == (safety.ACTION_RETRACT, Wanted(Count(0, 0), -5e-9, HERE))
    assert runner.capture().reached == before
    runner.follow_guard(safety.MODE_RETRACTING, safety.REASON_RETRACT_REQUESTED)
    assert runner.report()[1:3] == ("ended", "the long search ended, it was aborted")
    assert runner.is_over
    # the next one is another
    runner.end()
    ask(runner, "count")
    assert runner.step(INPUTS, DT).action == safety.ACTION_POSITION


@pytest.mark.parametrize(
    ("mode", "device_lost", "reason"),
    [
        (safety.MODE_RETRACTING, False, "the tip is still retracting"),
        (safety.MODE_ESTOP, False, "the emergency stop is latched: arm the AFM first"),
        (safety.MODE_RETRACTED, True, "the instrument is lost"),
    ],
)
def test_a_program_begins_only_where_the_instrument_is_ready(
    runner: ProgramRunner, mode: int, device_lost: bool, reason: str
) -> None:
    with pytest.raises(RefusedError, match=f"^program: {reason}$"):
        ask(runner, "count", mode=mode, device_lost=device_lost)
    assert runner.name == ""
    for ready in (safety.MODE_RETRACTED, safety.MODE_FOLLOW, safety.MODE_HOLD):
        assert ask(runner, "count", mode=ready) == "it counts"
        with pytest.raises(RefusedError, match=r"^program: a count is running; abort it first$"):
            ask(runner, "search")
        runner.end()


def test_a_surface_that_is_not_found_in_time_ends_the_program_and_says_where_the_base_is(runner: ProgramRunner) -> None:
    ask(runner, "search", 10)
    # at one second it may still look
    for _ in range(3):
        assert runner.step(INPUTS, DT).action == safety.ACTION_POSITION
    assert runner.step(INPUTS, DT).action == safety.ACTION_RETRACT
    runner.follow_guard(safety.MODE_RETRACTING, safety.REASON_RETRACT_REQUESTED)
    text = (
        "the long search ended, the surface was not found within 1 s, with the base at -5e-09 m (safety.base_max_m is"
        " 2e-06 m): bring the sample nearer, or allow the base to go further"
    )
    assert runner.report()[1:3] == ("ended", text)


def test_an_abort_of_a_search_that_takes_too_long_stays_an_abort(runner: ProgramRunner) -> None:
    ask(runner, "search", 10)
    for _ in range(3):
        runner.step(INPUTS, DT)
    ask(runner, "abort")
    runner.step(INPUTS, DT)
    runner.follow_guard(safety.MODE_RETRACTING, safety.REASON_RETRACT_REQUESTED)
    assert runner.report().text == "the long search ended, it was aborted"


@pytest.mark.parametrize("aborted", [False, True])
def test_what_the_guard_stops_itself_is_named_unless_the_program_ends_already(
    runner: ProgramRunner, aborted: bool
) -> None:
    ask(runner, "count")
    runner.step(INPUTS, DT)
    if aborted:
        runner.abort()
    runner.follow_guard(safety.MODE_ESTOP, safety.REASON_FORCE_LIMIT)
    reason = "it was aborted" if aborted else "the guard has retracted the tip: force_limit"
    # it is where it was
    assert runner.report() == ("count", "ended", f"the count ended, {reason}", 25.0, 1, 4, None)


def test_what_a_finished_program_did_not_reach_is_said(runner: ProgramRunner) -> None:
    ask(runner, "search", 1)
    runner.step(INPUTS, DT)
    runner.follow_guard(safety.MODE_RETRACTED, safety.REASON_RETRACT_REQUESTED)
    assert runner.report().text == "the long search is finished but for one point: the tip retracts"


@pytest.mark.parametrize("scans", [False, True])
def test_an_instrument_with_a_scan_of_its_own_takes_images_by_it_and_by_nothing_else(
    runner: ProgramRunner, monkeypatch: pytest.MonkeyPatch, scans: bool
) -> None:
    def taking(how: str) -> Counting:
        program = Counting()
        monkeypatch.setattr(program, "begin", lambda *_: Begun(Counted(1, HERE), Count(0, 0), how, ""))
        return program

    monkeypatch.setattr("telenano.afm.programs.runner.OWN_SCAN", taking("by its own scan"))
    monkeypatch.setitem(PROGRAMS, "scan", taking("line by line"))
    of_it = ProgramRunner(instrument()._replace(scans=scans), PROGRAMS)
    assert ask(of_it, "scan") == ("by its own scan" if scans else "line by line")
    of_it.end()
    assert ask(of_it, "count") == "it counts"


def test_a_runner_goes_on_from_the_state_of_another(runner: ProgramRunner) -> None:
    ask(runner, "count")
    runner.step(INPUTS, DT)
    ask(runner, "pause")
    other = ProgramRunner(instrument(), PROGRAMS)
    other.restore(runner.capture())
    assert (other.report(), other.take_notice()) == (runner.report(), "be careful")
    for each in (runner, other):
        ask(each, "resume")
        each.take_notice()
    assert other.step(INPUTS, DT) == runner.step(INPUTS, DT)
    assert other.capture() == runner.capture()


def test_a_state_of_a_program_that_is_not_there_or_has_changed_is_refused(
    runner: ProgramRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    ask(runner, "count")
    state = runner.capture()
    assert state.plan is not None
    assert state.reached is not None
    changed = state._replace(reached=state.reached._replace(names=("step", "waits")))
    with pytest.raises(ValueError, match="it lacks paused and has in addition waits"):
        ProgramRunner(instrument(), PROGRAMS).restore(changed)
    monkeypatch.delitem(PROGRAMS, "count")
    with pytest.raises(KeyError):
        ProgramRunner(instrument(), PROGRAMS).restore(state)
