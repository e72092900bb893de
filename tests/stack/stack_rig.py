"""A real rig in a socket folder of its own."""

import subprocess
import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import doubles_path  # noqa: F401
import machine
import pytest
from commands import COMMANDS
from figure_layout import arrows, faults
from following import Following, Recorded
from ledger import A_SITE

from telenano.analysis import Session
from telenano.analysis.fig12 import draw_fig12
from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.recording.reader import Recording
from telenano.testing.processes import PATIENCE_S, LiveRig
from telenano.wire.messages import AfmState
from telenano.wire.nodes import JOINED

__all__ = ["PATIENCE_S"]
# a hand that takes up the sample and stays pressed onto it
CONSTANT_PUSH = "haptic_node.operator.points=[{time_s: 0.2, force_n: 0.0}, {time_s: 0.6, force_n: 1.0}]"
# the hand of the scenario fig12, which is over after 8 s, and then that push
FIGURE_S = 8.0
FIGURE_AND_PUSH = "haptic_node.operator.points=[{time_s: 0.8, force_n: 0.0}, {time_s: 1.2, force_n: 1.0}, \
{time_s: 2.6, force_n: 1.0}, {time_s: 2.9, force_n: 2.0}, {time_s: 4.5, force_n: 2.0}, {time_s: 4.6, force_n: 0.0}, \
{time_s: 8.2, force_n: 0.0}, {time_s: 8.6, force_n: 1.0}]"
ROOT = Path(__file__).resolve().parents[2]
# The rig with a process a site is in `make check` where the change touches what joins nodes, and in `make endurance`
# otherwise: the guards that it tries are those of `node`, in one order with their mates.
OF_A_SITE = pytest.mark.drawn(0.0, "telenano/runtime/site/", "services/site/")
# A test about safety has a rig of either way.
# A rig of a module is kept from test to test, because the parameter has the scope of a module as well; `conftest.py`
# keeps the order of these tests.
BOTH_WAYS = pytest.mark.parametrize(
    "processes",
    ["node", pytest.param("site", marks=OF_A_SITE)],
    indirect=True,
    scope="module",
)


def apart(reason: str) -> pytest.MarkDecorator:
    """Have a test with a process a node alone, for a reason that its name has."""
    rows = [pytest.param("node", id=f"node: {reason}")]
    return pytest.mark.parametrize("processes", rows, indirect=True, scope="module")


# the deepest pull of Fig. 12 [nN], the longest step of the tip there at 1 kHz [nm], and how
# steeply the force leaves the deepest place on its flatter side, in contact [nN/nm]
PULL_NN, PULL_STEP_NM, PULL_SLOPE = -12.5, 0.035, 10.0
# A loop that stood still for longer than this has been given a blow.
HELD_UP_MS = 15.0
# A session is run as often as this until the machine lets one through without a blow.
SESSIONS = 3
# At what rate it is run each time, where nothing that is compared with it has a rate of its own.
RATES: tuple[Sequence[str], ...] = ((), ("--set", "realtime.rate_hz=500"), machine.LOWER_RATE)
# The guards that act where commands come too late, as a summary counts them.
GUARDS = {"tip_holds": "the tip was held", "hand_let_go": "the hand was let go"}


def pulled_as_in_the_paper(recording: Path) -> Any:
    """Give the range of the greatest pull of Fig. 12 that a recording allows.

    The hand brings the tip through the deepest place within three milliseconds. A loop of a lower rate, or one that is
    held up there, takes a longer step over it, and the recording says how long that step was.
    """
    states = [state for one in Recording(recording).messages() if isinstance(state := one.decode(), AfmState)]
    steps_nm = [
        1e9 * abs(new.base_position_m[2] - old.base_position_m[2])
        for old, new in pairwise(states)
        if min(old.tip_force_n[2], new.tip_force_n[2]) < 0.8e-9 * PULL_NN
    ]
    assert steps_nm, "the tip never came near the deepest pull"
    over_nm = max(*steps_nm, PULL_STEP_NM) - PULL_STEP_NM
    return pytest.approx(PULL_NN, abs=0.1 + PULL_SLOPE * over_nm)


def assert_drawn_as_in_the_paper(recording: Path, duration_s: float) -> None:
    """Check the figure of a recorded session of Fig. 12: limits, legend, texts and the places of arrows."""
    source = Recording(recording)
    session = Session.of(source)
    figure = draw_fig12(session.series(), "title")
    forces, positions, path = figure.axes
    assert [axes.get_xlim() for axes in (forces, positions)] == [(0.0, pytest.approx(duration_s, abs=0.5))] * 2
    assert [text.get_text() for text in path.get_legend().get_texts()] == ["approach", "retraction"]
    states = [state for one in source.messages(["afm/state"]) if isinstance(state := one.decode(), AfmState)]
    of_session = [state for state in states if session.start_ns <= state.t_ns <= session.end_ns]
    found = arrows(path)
    for text, name in (("meniscus forms", "meniscus"), ("contact begins", "in_contact")):
        before, after = next(two for two in pairwise(of_session) if getattr(two[1], name))
        place = next(at for words, at in found.items() if words.startswith(text))
        assert place == (1e9 * before.separation_m, 1e9 * before.tip_force_n[2])
        if name == "meniscus":
            assert after.separation_m <= 2.4e-9 <= before.separation_m + 0.01e-9
    # the base comes from 110 nm, and the hand's place is at 10 nm
    placed_nm = [1e9 * state.separation_m for state in of_session if state.mode == "follow" and not state.limited]
    room = 0.051 * (max(placed_nm) - min(placed_nm))
    assert max(placed_nm) == pytest.approx(10.0, abs=0.1)
    assert path.get_xlim() == (
        pytest.approx(min(placed_nm), abs=room), pytest.approx(max(placed_nm), abs=room),
    )  # fmt: skip
    assert faults(figure) == []


def held_up(summary: Mapping[str, Any]) -> str:
    """Return in words what the machine did to a session; empty where the session shows its law and not the machine."""
    age = summary["loop_age_ms"]
    if age is None:
        return "no command came back"
    still_ms = age["max"] - age["p50"]
    found = [f"its loop stood still for {still_ms:.0f} ms"] if still_ms > HELD_UP_MS else []
    found += [f"{what} {summary[key]} times" for key, what in GUARDS.items() if summary[key]]
    return " and ".join(found)


def judged(summary: Mapping[str, Any], what: str) -> bool:
    """Return whether the motion of a session can be judged; print where it cannot, and why."""
    if cause := held_up(summary):
        machine.note(f"{what}: verdict, hold and contact were not judged, because {cause}")
    return not cause


class Rig(LiveRig):
    """A rig of processes that this machine may hold up, and the commands of a person beside it."""

    before_start = staticmethod(machine.usual_priority)
    working_folder = ROOT

    def __init__(self, folder: Path, processes: str = "node") -> None:
        """Prepare a rig with a process a node, or a site."""
        super().__init__(folder)
        self.usual = ("--set", f"realtime.processes={processes}")
        self.processes = processes
        self._recorded = Recorded()

    @property
    def way(self) -> str:
        """What the table of faults adds to a fault that was injected into a rig with a process a site."""
        return A_SITE if self.processes == "site" else ""

    def mates_of(self, node: str) -> tuple[str, ...]:
        """Return the nodes that run in the process of a node, itself among them."""
        joined = JOINED.values() if self.processes == "site" else ()
        return next((nodes for nodes in joined if node in nodes), (node,))

    def start(self, *arguments: str, scenario: str = "fig12", rate: Sequence[str] | None = None) -> None:
        # the dwell of an image asks for the rate of its scenario
        if rate is None:
            rate = machine.LOWER_RATE if scenario == "fig12" else ()
        super().start(*rate, *arguments, scenario=scenario)

    def run(self, *arguments: str, scenario: str = "fig12", rate: Sequence[str] = ()) -> dict[str, Any]:
        """Run a session from beginning to end, at the rate of its scenario or another one, and give its summary."""
        self.start(*arguments, scenario=scenario, rate=rate)
        code, summary, err = self.finish()
        # a recorder that the machine held up may have lost something, and says so
        starved = code == EXIT_INCOMPLETE and bool(held_up(summary))
        assert code == 0 or starved, err + self.logs()
        if starved:
            machine.note(f"{scenario}: {err.strip().splitlines()[-1]}, because {held_up(summary)}")
        return summary

    def run_undisturbed(self, *arguments: str, scenario: str = "fig12") -> dict[str, Any]:
        """Run sessions until the machine lets one through without a blow, and give the summary of the last.

        The first has the rate of its scenario, each further one a lower rate: a machine that has not room for the first
        will not have it a minute later.
        """
        for rate in RATES:
            summary = self.run(*arguments, scenario=scenario, rate=rate)
            if not (cause := held_up(summary)):
                break
            machine.note(f"{scenario} {' '.join(rate)}: run again at a lower rate, because {cause}")
        return summary

    def telenano(self, *arguments: str, patience_s: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run another telenano command beside the rig."""
        return COMMANDS.run(arguments, self.environment, patience_s)

    def recording(self) -> Following:
        """Give what the recorder of the rig has written, up to now."""
        return self._recorded.newest(self.out)

    def newest(self, topic: str) -> Any:
        """Give the newest message of a topic in the recording, once there is one: a recorder may be behind."""
        self.wait_until(lambda: self.recording().newest(topic) is not None, f"{topic} in the recording")
        newest = self.recording().newest(topic)
        assert newest is not None
        return newest.decode()

    def session_s(self) -> float:
        """Give how long the operator's force profile has run, by the newest state of the hand in the recording."""
        newest = self.recording().newest("haptic/state")
        return -1.0 if newest is None else float(newest.fields()["session_s"])


def first_of_the_session(recordings: Sequence[Path]) -> tuple[Any, Any]:
    """Return the newest state of the tip at the first tick of the hand's program, and that tick."""
    topics = ["haptic/state", "afm/state"]
    states: list[Any] = [each.decode() for path in recordings for each in Recording(path).messages(topics)]
    start = next(state for state in states if getattr(state, "session_s", -1.0) >= 0.0)
    before = (each for each in states if hasattr(each, "placed") and each.t_ns <= start.t_ns)
    return max(before, key=lambda each: int(each.t_ns)), start


def mode(rig: Rig) -> str:
    """Return the mode of the tip."""
    return str(rig.newest("afm/state").mode)


def arm(rig: Rig) -> None:
    """Arm both devices of a rig as a person does, and let the tip, when it follows, go back to its place.

    A tip that stays withdrawn is further from the sample than the travel of a hand in its middle: the hand comes to its
    end, whose wall takes the force of the operator, and a law that carries forces loses contact.
    """
    for device in ("afm_node", "haptic_node"):
        rig.wait_until(
            lambda device=device: rig.telenano("session", "arm", "--target", device).returncode == 0, f"{device} armed"
        )
    rig.wait_until(lambda: mode(rig) == "follow", "a tip that follows")
    rig.wait_until(lambda: rig.telenano("session", "arm", "--return").returncode == 0, "a tip at its place")


def decoded(rig: Rig, topic: str, since_ns: int = 0) -> list[Any]:
    return [message.decode() for message in rig.recording().messages(topic, since_ns)]


def wait_for_the_recorder(rig: Rig, *channels: str) -> None:
    """Wait until all that was sent on some channels until now is in the recording: something later is."""
    now_ns = time.time_ns()
    for channel in channels or ("afm/state", "haptic/state", "teleop/forward", "teleop/backward"):
        rig.wait_until(lambda c=channel: rig.newest(c).t_ns > now_ns, f"{channel} recorded")
