"""A session that leaves what its law was shown to hold is warned of once, and again only after it has come back."""

from collections.abc import Sequence
from typing import Any

import msgspec
import pytest
from launcher_bench import Rig

from telenano.launcher import shown_watch
from telenano.launcher.shown import Cell, Place, Shown
from telenano.launcher.shown_watch import ShownWatch, laws_as_shown
from telenano.laws.config import ControllerConfig
from telenano.runtime.loop.log import StructuredLog
from telenano.settings.config import validate
from telenano.testing.filled_messages import examples
from telenano.wire.messages import Message, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import TOPICS

STATUS, STATE = (examples(TOPICS[topic])["ordinary"] for topic in ("law/status", "afm/state"))
TABLE = {
    "wave": Shown([Cell(Place(ms, 5.0, k, 10.0), 32, 32, 0.89) for ms in (0.0, 20.0) for k in (20.0, 80.0)], 0.1),
    "passivity": Shown([Cell(Place(90.0, 20.0, k, 10.0), 32, 32, 0.89) for k in (20.0, 80.0)], 0.5),
}


class Reader:
    """What has come since it was read last."""

    drained = True

    def __init__(self) -> None:
        self.waiting: list[Message] = []

    def receive(self) -> Sequence[Received]:
        waiting, self.waiting = self.waiting, []
        return [Received("", message, b"", 0, Arrival.NEXT) for message in waiting]


class WatchedRig(Rig):
    """A rig that runs a session, with the line and the contact that its controller and its instrument state."""

    def __init__(self, laws: Sequence[str] = ("wave", "passivity")) -> None:
        super().__init__(3600.0)
        self.reader = Reader()
        readers: Any = [self.reader]
        self.session.shown = ShownWatch(self.clock, StructuredLog("launcher@master"), laws, readers)
        self.all_ready()
        self.tick_alive(5)
        assert self.session.phase == "running"

    def run(self, seconds: float, round_trip_s: float, **state: Any) -> list[SessionEvent]:
        """Let time pass, and return the warnings of it."""
        before = len(self.bus.sent)
        for _ in range(round(20 * seconds)):
            t_ns = self.clock.now_ns()
            law = state.get("law", "wave")
            self.reader.waiting = [
                msgspec.structs.replace(STATUS, t_ns=t_ns, law=law, round_trip_valid=True, round_trip_s=round_trip_s),
                # the other half knows no round trip, and may be at another law for a moment
                msgspec.structs.replace(STATUS, t_ns=t_ns, law="passivity", round_trip_valid=False),
                msgspec.structs.replace(STATE, t_ns=t_ns, in_contact=False),
            ]
            self.tick_alive()
        sent = [message for message in self.bus.sent[before:] if isinstance(message, SessionEvent)]
        return [event for event in sent if "outside" in event.data]


@pytest.fixture(autouse=True)
def table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown_watch, "read_shown", lambda: TABLE)


def test_a_session_inside_is_not_warned_of() -> None:
    rig = WatchedRig()
    # the processes of a rig take some milliseconds of what is measured
    assert rig.run(30.0, 0.024) == []


def test_one_event_and_one_line_for_a_session_that_is_outside_for_long() -> None:
    rig = WatchedRig()
    (event,) = rig.run(100.0, 0.078)
    assert (event.kind, event.level, event.src) == ("node", "warning", "launcher@master")
    assert event.text.startswith(
        "The line is outside of the range in which wave held in the benchmark: 78 ms there and back"
    )
    assert "Take passivity (--set controller.law=passivity) or a shorter line." in event.text
    assert (event.data["outside"], event.data["law"], event.data["round_trip_ms"]) == ("line", "wave", 78.0)
    assert float(event.data["least_round_trip_ms"]) < 78.0 < float(event.data["most_round_trip_ms"])
    assert [text for text in rig.reports if "held in the benchmark" in text] == [event.text]


def test_it_is_warned_of_again_only_after_it_was_inside_for_a_while() -> None:
    rig = WatchedRig()
    assert len(rig.run(20.0, 0.078)) == 1
    # short returns, of a line that flickers between the two
    for _ in range(4):
        assert rig.run(14.0, 0.005) == []
        assert rig.run(14.0, 0.078) == []
    assert rig.run(40.0, 0.005) == []
    assert len(rig.run(20.0, 0.078)) == 1


def test_a_line_of_which_nothing_is_known_any_more_has_not_come_back() -> None:
    rig = WatchedRig()
    assert len(rig.run(20.0, 0.078)) == 1
    rig.tick_alive(20 * 20)
    assert rig.run(30.0, 0.078) == []


def test_another_law_is_another_question() -> None:
    rig = WatchedRig()
    assert len(rig.run(20.0, 0.12)) == 1
    (event,) = rig.run(20.0, 0.12, law="passivity")
    assert event.data["law"] == "passivity" and event.text.endswith("no law held such a session in the benchmark.")


@pytest.mark.parametrize(("law", "laws"), [("my_law", ("my_law",)), ("wave", ("passivity",))])
def test_nothing_is_known_of_a_law_that_is_not_in_the_table_or_has_other_settings(law: str, laws: tuple[str]) -> None:
    assert WatchedRig(laws).run(30.0, 0.3, law=law) == []


def test_a_failure_of_the_watch_ends_the_watch_and_no_session(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise OSError("no table")

    rig = WatchedRig()
    monkeypatch.setattr(shown_watch, "read_shown", fail)
    assert rig.run(10.0, 0.078) == []
    monkeypatch.setattr(shown_watch, "read_shown", lambda: TABLE)
    assert rig.run(10.0, 0.078) == []
    assert rig.session.phase == "running" and not rig.session.failure


def test_the_settings_of_a_law_are_those_that_were_run_where_nothing_but_the_law_is_chosen() -> None:
    def laws(**section: Any) -> list[str]:
        return laws_as_shown(validate(ControllerConfig, section, "a scenario", "controller"))

    every = laws()
    assert {"wave", "passivity", "virtual_impedance"} <= set(every) and "tactile" not in every
    assert laws(law="passivity") == every
    assert laws(wave={"impedance_n_s_per_m": 50.0}) == [law for law in every if law != "wave"]
    assert laws(deadband={"enabled": True}) == []
