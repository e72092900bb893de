"""Runs the programs of the instrument, one at a time, behind the guard, until each is done or ended."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Protocol

from telenano.afm import safety
from telenano.afm.programs.own_scan import OWN_SCAN
from telenano.extend.programs import AnyProgram, Inputs, Instrument, Wanted
from telenano.extend.stage import Place
from telenano.wire.errors import RefusedError
from telenano.wire.instrument import MOST_TEXT
from telenano.wire.messages import Scalar
from telenano.wire.node_state import Part, part

RunState = Literal["running", "paused", "finished", "ended"]
# Modes of the guard in which no program may begin, with the reason.
_NOT_READY = {
    safety.MODE_RETRACTING: "the tip is still retracting",
    safety.MODE_ESTOP: "the emergency stop is latched: arm the AFM first",
}


class ProgramRequest(Protocol):
    """The request of `set` for a program, with the settings of each program."""

    @property
    def program(self) -> str | None: ...

    def settings_of(self, program: str) -> Any:
        """Return the settings of a program."""


class GuardRequest(NamedTuple):
    """A request to the guard: an action, and the base, stage and vibration that the program wants."""

    action: int
    wanted: Wanted[Any]


class Report(NamedTuple):
    """The report on a program; `fields` returns the fields of the message afm/program."""

    program: str
    state: RunState
    text: str
    done_percent: float
    line: int
    lines: int
    values: Mapping[str, Scalar] | None = None

    def fields(self) -> dict[str, Any]:
        return {**self._asdict(), "text": self.text[:MOST_TEXT]}


class RunnerState(NamedTuple):
    """Name and state of the running program, with its plan and its own state, None where nothing runs."""

    name: str
    state: RunState
    aborted: str
    notice: str
    plan: Part | None
    reached: Part | None


class ProgramRunner:
    """Runs one program at a time.

    `name` is the name of the program, empty while there is none; `state` says whether it runs.
    """

    def __init__(self, instrument: Instrument, programs: Mapping[str, AnyProgram]) -> None:
        self.name = ""
        self.state: RunState = "finished"
        self._instrument, self._table = instrument, programs
        self._plan: Any = None
        self._reached: Any = None
        self._aborted, self._notice = "", ""

    def capture(self) -> RunnerState:
        """Return the state of the runner, for `restore`."""
        made = (part(self._plan), part(self._reached)) if self.name else (None, None)
        return RunnerState(self.name, self.state, self._aborted, self._notice, *made)

    def restore(self, state: RunnerState) -> None:
        """Continue from a captured state; raise ValueError or KeyError if its program has changed since."""
        self.name, self.state, self._aborted, self._notice, plan, reached = state
        if plan is not None and reached is not None:
            kind, kind_reached = self._program.kinds()
            self._plan, self._reached = plan.of_kind(kind), reached.of_kind(kind_reached)

    def request(self, request: ProgramRequest, mode: int, place: Place, *, device_lost: bool) -> str:
        """Begin a program, or pause, resume or abort the one that runs; return a sentence about it.

        Args:
            request: The request.
            mode: The mode of the guard.
            place: The place of the tip.
            device_lost: Whether the device is lost.

        Raises:
            RefusedError: The request cannot be met; the message gives the reason.
        """
        wanted = request.program
        if wanted is not None and wanted in self._table:
            if self.name:
                raise RefusedError(f"program: a {self.name} is running; abort it first")
            if reason := "the instrument is lost" if device_lost else _NOT_READY.get(mode, ""):
                raise RefusedError(f"program: {reason}")
            begun = self._program_of(wanted).begin(request.settings_of(wanted), self._instrument, place)
            self.name, self.state, self._aborted = wanted, "running", ""
            self._plan, self._reached, self._notice = begun.plan, begun.state, begun.notice
            return begun.text
        if not self.name:
            raise RefusedError(f"program: no program runs, so there is nothing to {wanted}")
        if wanted == "abort":
            return self.abort()
        if not self._program.can_pause:
            raise RefusedError(f"program: a {self.name} cannot {wanted}, it can only be aborted")
        self.state = "paused" if wanted == "pause" else "running"
        return f"the {self.name} is {self.state}"

    def abort(self) -> str:
        """Mark the running program as aborted, so that the next step retracts the tip; return a sentence about it."""
        self._aborted = "it was aborted"
        return f"the {self._label} ends and the tip retracts"

    def take_notice(self) -> str:
        """Return the warning of the program, and clear it; empty for none."""
        notice, self._notice = self._notice, ""
        return notice

    def step(self, inputs: Inputs, dt: float) -> GuardRequest:
        """Step the program with the last measurement; return the request to the guard for the next dt [s]."""
        program, base_m = self._program, inputs.base_m
        searched_s, limit_s = program.searching_s(self._plan, self._reached)
        if searched_s > limit_s and not self._aborted:
            self._aborted = (
                f"the surface was not found within {limit_s:.3g} s, with the base at {base_m:.3g} m (safety.base_max_m"
                f" is {self._instrument.limits.base_max_m:g} m): bring the sample nearer, or allow the base to go"
                " further"
            )
        if self._aborted:
            return GuardRequest(safety.ACTION_RETRACT, Wanted(self._reached, base_m, inputs.place))
        wanted = program.step(self._plan, self._reached, inputs._replace(is_paused=self.state == "paused"), dt)
        self._reached = wanted.state
        self._notice = self._notice or wanted.notice
        return GuardRequest(safety.ACTION_RETRACT if wanted.is_done else safety.ACTION_POSITION, wanted)

    def follow_guard(self, mode: int, reason: int) -> None:
        """End the program if the guard has left FOLLOW and HOLD: because the program is done, or against its will."""
        if mode in (safety.MODE_FOLLOW, safety.MODE_HOLD):
            return
        if reason != safety.REASON_RETRACT_REQUESTED and not self._aborted:
            self._aborted = f"the guard has retracted the tip: {safety.REASON_NAMES[reason]}"
        self.state = "ended" if self._aborted else "finished"

    def report(self) -> Report:
        """Return the report on the progress of the program."""
        text, share, line, lines, values = self._program.progress(self._plan, self._reached)
        if self.state == "finished":
            reached = self._program.shortfall(self._plan, self._reached)
            text, share = f"the {self._label} is finished{reached}: the tip retracts", 1.0
        elif self.state == "ended":
            text = f"the {self._label} ended, {self._aborted}"
        return Report(self.name, self.state, text, 100.0 * share, line, lines, values)

    @property
    def is_over(self) -> bool:
        """Whether the program has finished or was ended, so that `end` may be called."""
        return self.state in ("finished", "ended")

    @property
    def leaves_tip(self) -> bool:
        """Whether the stage stays at the place where the program ends."""
        return self._program.leaves_tip

    def end(self) -> None:
        """Forget a program that is over."""
        self.name, self._plan, self._reached = "", None, None

    @property
    def _program(self) -> AnyProgram:
        return self._program_of(self.name)

    def _program_of(self, name: str) -> AnyProgram:
        return OWN_SCAN if name == "scan" and self._instrument.scans else self._table[name]

    @property
    def _label(self) -> str:
        return self._program.label or self.name
