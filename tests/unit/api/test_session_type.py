"""A session is one type, recorded or simulated: what a program reads of the one it reads of the other."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import telenano
from telenano.testing import hand_recording
from telenano.wire.errors import RecordingError

KINDS = ("recorded", "simulated")


@pytest.fixture(scope="module")
def sessions(recording_of: Callable[[str], Path]) -> dict[str, telenano.Session]:
    simulated = telenano.simulate("fig12", law="virtual_impedance", round_trip_ms=8.0, duration_s=1.1)
    return {"recorded": telenano.open(recording_of("virtual_impedance")), "simulated": simulated}


@pytest.mark.parametrize("kind", KINDS)
def test_a_session_has_verdict_holds_and_what_was_set(sessions: dict[str, telenano.Session], kind: str) -> None:
    session = sessions[kind]
    assert isinstance(session, telenano.Session)
    assert session.reason and session.verdict in ("stable", "cannot_say")
    assert all(hold.end_s > hold.start_s and hold.reason for hold in session.holds)
    found = session.conditions
    assert (found.scenario, found.law, found.instrument) == ("fig12", "virtual_impedance", "ideal")
    assert (found.sample, found.hand, found.changed) == ("tip_sample", "force_profile to 2 N", ())
    assert found.parameters["force_gain"] == 20.0
    assert "virtual_impedance" in found.title()
    assert {"haptic/state", "afm/state"} <= set(session.channels)
    assert all(
        session.table(channel, src)["time_s"].size for channel in ("afm/state",) for src in session.channels[channel]
    )


def test_what_was_set_is_equal_for_a_simulation_of_what_was_recorded(sessions: dict[str, telenano.Session]) -> None:
    recorded, simulated = (sessions[kind].conditions for kind in KINDS)
    assert set(recorded.row()) == set(simulated.row())
    differ = {name for name, value in recorded.row().items() if simulated.row()[name] != value}
    assert differ <= {"round_trip_ms", "link_profile"}


def test_the_delay_that_was_set_is_no_measured_one(recording_of: Callable[[str], Path]) -> None:
    session = telenano.open(recording_of("wave"))
    assert session.measured_round_trip_ms is not None
    # a mean of what was delivered is hardly ever a round number, and what was set is one
    assert session.conditions.round_trip_ms == round(session.conditions.round_trip_ms, 3)
    assert abs(session.measured_round_trip_ms - session.conditions.round_trip_ms) < 2.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_session_is_columns_of_one_length(sessions: dict[str, telenano.Session], kind: str) -> None:
    session = sessions[kind]
    assert set(session) == set(session.units) == set(session.descriptions) >= {"time_s", "tip_force_n", "reference_m"}
    assert {session[name].shape for name in session} == {session["time_s"].shape}
    assert session._ipython_key_completions_() == list(session)
    ratio = session["scaled_tip_force_n"] / session["tip_force_n"]
    assert np.nanmax(ratio) == pytest.approx(session.conditions.parameters["force_scale"])
    assert session.to_pandas()["tip_force_n"].size == session["time_s"].size


def test_columns_of_a_recording_and_of_its_simulation_agree(sessions: dict[str, telenano.Session]) -> None:
    # just before the end, on the way to the sample
    names = ("operator_force_n", "hand_position_m", "reference_m", "base_position_m", "separation_m")
    read = [
        [float(np.interp(1.05, session["time_s"], session[name])) for name in names] for session in sessions.values()
    ]
    assert read[0] == pytest.approx(read[1], rel=0.02)
    assert set(sessions["recorded"]) == set(sessions["simulated"])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("wrong", "meant"), [("tip_forc_n", "tip_force_n"), ("hand_position", "hand_position_m"), ("times_s", "time_s")]
)
def test_a_wrong_column_is_answered_with_the_one_that_was_meant(
    sessions: dict[str, telenano.Session], kind: str, wrong: str, meant: str
) -> None:
    with pytest.raises(
        KeyError, match=rf"session has no column '{wrong}'; did you mean {meant}\? Its columns are time_s"
    ):
        sessions[kind][wrong]


def test_a_vector_is_answered_with_its_components(sessions: dict[str, telenano.Session]) -> None:
    tip = sessions["recorded"].table("afm/state")
    with pytest.raises(
        KeyError, match=r"'tip_force_n'; did you mean tip_force_n\.0 or tip_force_n\.1 or tip_force_n\.2\?"
    ):
        tip["tip_force_n"]
    assert tip._ipython_key_completions_() == list(tip)


@pytest.mark.parametrize("kind", KINDS)
def test_a_session_is_itself_and_true(sessions: dict[str, telenano.Session], kind: str) -> None:
    session = sessions[kind]
    assert session and session == session and session in {session} and session != sessions[KINDS[kind == "recorded"]]


@pytest.mark.parametrize("kind", KINDS)
def test_a_notebook_shows_verdict_and_holds_in_few_lines(sessions: dict[str, telenano.Session], kind: str) -> None:
    shown = sessions[kind]._repr_html_()
    assert len(shown.splitlines()) <= 20
    assert sessions[kind].verdict.replace("_", " ") in shown and sessions[kind].conditions.law in shown


@pytest.mark.check("takes 2 s")
def test_many_holds_are_counted_and_not_listed(
    sessions: dict[str, telenano.Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    longer = telenano.simulate("fig12", round_trip_ms=8.0)
    holds = [longer.holds[0]._replace(reason="<b> & more")] * 40
    monkeypatch.setitem(longer.__dict__, "holds", holds)
    shown = longer._repr_html_()
    assert len(shown.splitlines()) <= 20
    assert "and 30 more holds" in shown
    assert "<b> & more" not in shown and "&lt;b&gt; &amp; more" in shown


@pytest.mark.parametrize("kind", KINDS)
def test_a_session_is_drawn_with_its_conditions(sessions: dict[str, telenano.Session], kind: str) -> None:
    figure = sessions[kind].plot()
    assert len(figure.axes) == 3
    assert "virtual_impedance" in figure.get_suptitle()
    curves = [np.asarray(line.get_ydata(), dtype=float) for line in figure.axes[0].lines]
    assert max(map(np.nanmax, curves)) == pytest.approx(np.nanmax(sessions[kind]["operator_force_n"]), rel=0.05)


def test_a_recording_whose_session_cannot_be_read_says_so_wherever_it_is_asked(tmp_path: Path) -> None:
    session = telenano.open(hand_recording(tmp_path, 50))
    for ask in ("verdict", "reason", "holds", "conditions", "summary", "course"):
        with pytest.raises(RecordingError, match="no scenario attached"):
            getattr(session, ask)
    assert session._ipython_key_completions_() == []
    assert "no scenario attached" in session._repr_html_()
    assert session.channels and session.start_ns is None
