"""Tables for programs: session time, units, one publisher at a time."""

import re
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import zmq
from recorder_samples import sample
from telenano_lab.studies.repetitions import share, statistic

import telenano
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.timing.clock import SystemClock
from telenano.wire.errors import ConfigError, RecordingError, RigError


@pytest.fixture(scope="module")
def session(recording_of: Callable[[str], Path]) -> telenano.RecordedSession:
    return telenano.open(recording_of("wave"))


def test_a_table_has_the_time_of_the_session_and_a_unit_for_each_column(session: telenano.RecordedSession) -> None:
    hand = session.table("haptic/state")
    running = hand["session_s"] >= 0.0
    # the hand's own account of it, in whole periods of 1 ms
    assert np.abs(hand["time_s"] - hand["session_s"])[running].max() < 0.01
    assert (np.diff(hand["time_s"]) >= 0.0).all()
    assert set(hand.units) == set(hand) == set(hand.descriptions)
    assert (hand.units["operator_force_n.2"], hand.units["time_s"], hand.units["mode"]) == ("N", "s", "")
    # the hand presses towards the sample, which is -z
    assert hand["operator_force_n.2"].min() < -0.1
    with pytest.raises(KeyError, match=r"haptic/state has no column 'force'; its columns are time_s, log_ns"):
        hand["force"]


def test_publishers_of_a_channel_are_kept_apart(session: telenano.RecordedSession) -> None:
    with pytest.raises(RecordingError, match="several publishers, give one of controller@master, controller@slave"):
        session.table("law/status")
    halves = [session.table("law/status", src) for src in session.channels["law/status"]]
    assert [set(half["src"]) for half in halves] == [{"controller@master"}, {"controller@slave"}]
    # only the master has a round trip
    assert [half["round_trip_valid"].any() for half in halves] == [True, False]
    both = session.table("law/status", "*")
    assert set(both["src"]) == {"controller@master", "controller@slave"}
    assert len(both["time_s"]) == sum(len(half["time_s"]) for half in halves)
    assert (np.diff(both["time_s"]) >= 0.0).all()
    with pytest.raises(RecordingError, match="law/status: recorder@master published nothing on it"):
        session.table("law/status", "recorder@master")
    with pytest.raises(RecordingError, match="has no channel afm; did you mean afm/command or afm/state"):
        session.table("afm")


def test_a_folder_is_opened_where_it_has_one_recording(recording_of: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"is a folder with 0 recordings \(\.mcap\); give the file"):
        telenano.open(tmp_path)
    recording = recording_of("wave").resolve()
    (tmp_path / "session.mcap").symlink_to(recording)
    (tmp_path / "summary.json").write_text("{}")
    assert telenano.open(tmp_path).channels == telenano.open(recording).channels
    (tmp_path / "take.mcap").symlink_to(recording)
    with pytest.raises(RecordingError, match=r"with 2 recordings .*give the file of session\.mcap, take\.mcap"):
        telenano.open(tmp_path)


def test_what_simulate_cannot_take_is_said_in_its_own_words() -> None:
    with pytest.raises(ConfigError, match="round_trip_ms: must be a number of milliseconds, got '40'"):
        telenano.simulate(round_trip_ms="40")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"telenano\.simulate: has no argument 'delay'; did you mean round_trip_ms"):
        telenano.simulate(delay=40.0)  # type: ignore[call-arg]


@pytest.mark.check("takes 2 s")
def test_a_value_that_is_not_there_is_nan(
    session: telenano.RecordedSession, recording_of: Callable[[str], Path]
) -> None:
    assert np.isfinite(session.table("teleop/forward")["wave_sqrt_w.2"]).all()
    other = telenano.open(recording_of("virtual_impedance")).table("teleop/forward")
    assert set(other["wave_sqrt_w"]) == {None}


def test_the_summary_is_that_of_the_report(session: telenano.RecordedSession) -> None:
    assert (session.summary["scenario"], session.summary["law"]) == ("fig12", ["wave"])


def test_a_data_frame_is_the_table(session: telenano.RecordedSession) -> None:
    frame = session.df("afm/state")
    assert frame["tip_force_n.2"].tolist() == session.table("afm/state")["tip_force_n.2"].tolist()
    assert frame.attrs["units"]["tip_force_n.2"] == "N"


def test_a_simulation_and_a_recording_are_read_by_the_same_code(recording_of: Callable[[str], Path]) -> None:
    session = telenano.open(recording_of("virtual_impedance"))
    simulated = telenano.simulate("fig12", law="virtual_impedance", round_trip_ms=8.0, duration_s=1.1)
    assert "virtual_impedance" in repr(simulated)
    assert simulated.verdict in repr(simulated)
    assert "channels, with a session" in repr(session)
    read = []
    for source in (simulated, session):
        hand, tip = source.table("haptic/state"), source.table("afm/state")
        assert hand.units["position_m.2"] == tip.units["base_position_m.2"] == "m"
        columns = [(hand, "position_m.2"), (hand, "operator_force_n.2"), (hand, "reference_m.2")]
        columns += [(tip, "base_position_m.2"), (tip, "tip_force_n.2"), (tip, "separation_m")]
        # just before the end, on the way to the sample
        read.append([float(np.interp(1.05, table["time_s"], table[name])) for table, name in columns])
    assert read[0] == pytest.approx(read[1], rel=0.02)
    assert max(read[0][:5]) < 0.0
    with pytest.raises(ConfigError, match="a simulation has no such channel; known are haptic/state, afm/state"):
        simulated.table("law/status")


def test_every_public_class_shows_in_a_line_what_it_is(session: telenano.RecordedSession) -> None:
    tip = session.table("afm/state")
    rig = telenano.LiveRig(SimpleNamespace(subscribers={"haptic_node@master": 0, "afm_node@slave": 0}))
    shown = [repr(thing) for thing in (session, tip, rig)]
    assert re.fullmatch(
        r"<RecordedSession .*fig12_wave.*\.mcap: \d+ channels, with a session of the operator>", shown[0]
    )
    assert shown[1].startswith(f"<Table afm/state: {len(tip['time_s'])} rows of time_s, ")
    assert shown[2] == "<LiveRig: afm_node@slave, haptic_node@master>"
    classes = {name for name in telenano.__all__ if isinstance(getattr(telenano, name), type)}
    assert {name for name in classes if getattr(telenano, name).__repr__ is object.__repr__} == set()
    assert classes == {"LiveRig", "RecordedSession", "Session", "SimulatedSession", "Table"}
    assert (str(statistic([1.0, 2.0, 3.0])), str(share(3, 4))) == ("2 ± 1 [-0.484, 4.48]", "0.75 [0.301, 0.954]")


@pytest.mark.check("takes 0.8 s")
def test_a_table_becomes_a_labelled_data_set(session: telenano.RecordedSession) -> None:
    pytest.importorskip("xarray")
    tip = session.table("afm/state")
    data = tip.to_xarray()
    assert data["tip_force_n.2"].attrs["units"] == "N"
    assert data["tip_force_n.2"].values.tolist() == tip["tip_force_n.2"].tolist()
    assert data.sizes["time_s"] == len(tip["time_s"])
    assert {name: data[name].attrs["units"] for name in data.variables} == tip.units
    assert {name: data[name].attrs["long_name"] for name in data.variables} == tip.descriptions
    assert data["time_s"].attrs["units"] == "s"


def test_the_version_is_that_of_the_distribution() -> None:
    assert telenano.__version__ == version("telenano")


def test_without_pandas_its_absence_is_named(
    session: telenano.RecordedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ConfigError, match=r"pandas is not installed: pip install (-e )?'.+\[export\]'"):
        session.df("afm/state")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none\.mcap"):
        telenano.open(tmp_path / "none.mcap")


def test_a_running_rig_is_read(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/hand"
    site = tmp_path / "site.yaml"
    site.write_text(f"nodes: {{haptic_node@master: '{endpoint}'}}\n")
    given = msgspec.structs.asdict(sample("haptic/state", 0, session_s=2.5))
    fields = {name: value for name, value in given.items() if name not in ("seq", "t_ns", "src", "v")}
    with pytest.raises(RigError, match="no rig of this site file was found here"), telenano.live(site):
        pass
    with zmq.Context[Any]() as context, ExitStack() as opened:
        hand = ZmqPublisher(context, SystemClock(), "haptic_node@master", endpoint)
        opened.callback(hand.close)
        rig = opened.enter_context(telenano.live(site))
        found: tuple[str, Any] | None = None
        while found is None:
            hand.publish("haptic/state", **fields)
            found = next(rig.messages(0.1), None)
        assert (found[0], found[1].src) == ("haptic/state", "haptic_node@master")
        hand.publish("haptic/state", **fields)
        table = rig.table("haptic/state", duration_s=0.2)
    assert table["time_s"][-1] == pytest.approx(2.5, abs=1e-6)


def test_a_law_that_is_unknown_is_named_with_those_that_are() -> None:
    with pytest.raises(ConfigError, match="unknown law 'my_law': known are virtual_impedance"):
        telenano.check_law("my_law")


def test_the_command_does_not_pay_for_it() -> None:
    code = "import sys, telenano; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    with pytest.raises(AttributeError, match="no attribute 'close'"):
        telenano.close  # noqa: B018
