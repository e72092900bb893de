"""A session that leaves what its law was shown to hold is warned of once, and again only after it has come back."""

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import pytest
from telenano_lab.experiments.benchmark.session_advice import BenchmarkAdviser, benchmark_adviser, laws_as_shown
from telenano_lab.experiments.benchmark.shown_range import Cell, LawRange, Place

from telenano.extend.advice import Advice, AdvisedSession
from telenano.sections import ControllerConfig
from telenano.settings import validate
from telenano.wire import Message, example

STATUS, STATE = (example(topic) for topic in ("law/status", "afm/state"))
TABLE = {
    "wave": LawRange([Cell(Place(ms, 5.0, k, 10.0), 32, 32, 0.89) for ms in (0.0, 20.0) for k in (20.0, 80.0)], 0.1),
    "passivity": LawRange([Cell(Place(90.0, 20.0, k, 10.0), 32, 32, 0.89) for k in (20.0, 80.0)], 0.5),
}
TICK_NS = 50_000_000


class WatchedSession:
    """A session with the line and the contact that its controller and its instrument state."""

    def __init__(self, laws: Sequence[str] = ("wave", "passivity")) -> None:
        self.now_ns = 1_000_000_000
        self.adviser = BenchmarkAdviser(lambda: self.now_ns, laws, read_table=lambda: TABLE)

    def look(self, messages: Iterable[Message]) -> Advice | None:
        self.now_ns += TICK_NS
        return self.adviser.look(messages, runs=True)

    def run(self, seconds: float, round_trip_s: float, law: str = "wave") -> list[Advice]:
        """Let time pass, and return the warnings of it."""
        found = []
        for _ in range(round(20 * seconds)):
            at: dict[str, Any] = {"t_ns": self.now_ns}
            advice = self.look(
                [
                    msgspec.structs.replace(STATUS, **at, law=law, round_trip_valid=True, round_trip_s=round_trip_s),
                    # the other half knows no round trip, and may be at another law for a moment
                    msgspec.structs.replace(STATUS, **at, law="passivity", round_trip_valid=False),
                    msgspec.structs.replace(STATE, **at, in_contact=False),
                ]
            )
            found += [advice] if advice is not None else []
        return found


def test_a_session_inside_is_not_warned_of() -> None:
    session = WatchedSession()
    # the processes of a rig take some milliseconds of what is measured
    assert session.run(30.0, 0.024) == []


def test_one_warning_for_a_session_that_is_outside_for_long() -> None:
    session = WatchedSession()
    (advice,) = session.run(100.0, 0.078)
    assert advice.text.startswith(
        "The line is outside of the range in which wave held in the benchmark: 78 ms there and back"
    )
    assert "Take passivity (--set controller.law=passivity) or a shorter line." in advice.text
    assert (advice.facts["outside"], advice.facts["law"], advice.facts["round_trip_ms"]) == ("line", "wave", 78.0)
    assert float(advice.facts["least_round_trip_ms"]) < 78.0 < float(advice.facts["most_round_trip_ms"])


def test_it_is_warned_of_again_only_after_it_was_inside_for_a_while() -> None:
    session = WatchedSession()
    assert len(session.run(20.0, 0.078)) == 1
    # short returns, of a line that flickers between the two
    for _ in range(4):
        assert session.run(14.0, 0.005) == []
        assert session.run(14.0, 0.078) == []
    assert session.run(40.0, 0.005) == []
    assert len(session.run(20.0, 0.078)) == 1


def test_a_line_of_which_nothing_is_known_any_more_has_not_come_back() -> None:
    session = WatchedSession()
    assert len(session.run(20.0, 0.078)) == 1
    assert [session.look([]) for _ in range(20 * 20)] == [None] * 400
    assert session.run(30.0, 0.078) == []


def test_another_law_is_another_question() -> None:
    session = WatchedSession()
    assert len(session.run(20.0, 0.12)) == 1
    (advice,) = session.run(20.0, 0.12, law="passivity")
    assert advice.facts["law"] == "passivity" and advice.text.endswith("no law held such a session in the benchmark.")


@pytest.mark.parametrize(("law", "laws"), [("my_law", ("my_law",)), ("wave", ("passivity",))])
def test_nothing_is_known_of_a_law_that_is_not_in_the_table_or_has_other_settings(law: str, laws: tuple[str]) -> None:
    assert WatchedSession(laws).run(30.0, 0.3, law=law) == []


def test_the_settings_of_a_law_are_those_that_were_run_where_nothing_but_the_law_is_chosen() -> None:
    def laws(**section: Any) -> list[str]:
        return laws_as_shown(validate(ControllerConfig, section, "a scenario", "controller"))

    every = laws()
    assert {"wave", "passivity", "virtual_impedance"} <= set(every) and "tactile" not in every
    assert laws(law="passivity") == every
    assert laws(wave={"impedance_n_s_per_m": 50.0}) == [law for law in every if law != "wave"]
    assert laws(deadband={"enabled": True}) == []


def test_a_session_whose_laws_are_all_changed_has_no_adviser() -> None:
    def adviser(**section: Any) -> BenchmarkAdviser | None:
        controller = validate(ControllerConfig, section, "a scenario", "controller")
        return benchmark_adviser(AdvisedSession(controller, lambda: 0))

    assert adviser() is not None
    assert adviser(deadband={"enabled": True}) is None
