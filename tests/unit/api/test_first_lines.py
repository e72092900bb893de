"""What people type first in Python: other words for arguments, wrong types, habits of pandas."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import telenano
from telenano.settings import DEMO_RECORDING
from telenano.settings.included import find_scenario
from telenano.wire.errors import ConfigError, NoRecordingError, TelenanoError

pandas = pytest.importorskip("pandas")


@pytest.fixture(scope="module")
def simulated() -> telenano.SimulatedSession:
    return telenano.simulate("fig12", duration_s=0.5)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"delay": 40}, "did you mean round_trip_ms?"),
        ({"delay_ms": 40}, "did you mean round_trip_ms?"),
        ({"latency": 40}, "did you mean round_trip_ms?"),
        ({"rtt": 40}, "did you mean round_trip_ms?"),
        ({"duration": 2}, "did you mean duration_s?"),
        ({"sample": "mica"}, "did you mean environment?"),
        ({"hand": "still"}, "did you mean operator?"),
        ({"laws": "wave"}, "did you mean law?"),
        ({"gain": 5}, ".force_gain': 5}"),
        ({"K_f": 5}, ".force_gain': 5}"),
        ({"mass_kg": 5}, "settings={"),
        ({"zzz": 5}, "telenano param list"),
    ],
)
def test_an_unknown_argument_is_answered_with_what_is_meant(given: dict[str, Any], says: str) -> None:
    with pytest.raises(TypeError) as raised:
        telenano.simulate("fig12", **given)
    assert says in str(raised.value)


def test_a_value_without_a_name_is_answered_with_the_names() -> None:
    with pytest.raises(TypeError, match="given by name, as in law='wave'"):
        telenano.simulate("fig12", "wave")  # type: ignore[call-overload]


@pytest.mark.parametrize("scenario", [{"name": "x"}, None, 3, ["fig12"], b"fig12"])
def test_a_scenario_of_a_wrong_type_is_answered_with_the_right_one(scenario: Any) -> None:
    with pytest.raises(ConfigError, match="a scenario is a name such as fig12"):
        telenano.simulate(scenario)


def test_a_scenario_may_be_a_path(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_bytes(find_scenario("fig12").read_bytes())
    assert telenano.simulate(own, duration_s=0.05)["time_s"].size == 50


@pytest.mark.parametrize("call", [telenano.open, telenano.open_all])
@pytest.mark.parametrize("value", [None, 3, 2.5, [3]])
def test_a_recording_of_a_wrong_type_is_answered_with_the_right_one(call: Any, value: Any) -> None:
    with pytest.raises(TypeError, match="a recording is named by its path"):
        call(value)


@pytest.mark.parametrize(
    ("name", "says"), [("fig12", "telenano.simulate('fig12')"), ("out/*.mcap", "telenano.open_all takes")]
)
def test_what_is_no_recording_is_named(name: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NoRecordingError) as raised:
        telenano.open(name)
    assert says in str(raised.value)


@pytest.mark.parametrize("name", ["head", "describe", "to_csv", "iloc", "shape", "groupby"])
def test_what_pandas_has_is_got_by_pandas(name: str, simulated: telenano.SimulatedSession) -> None:
    for table in (simulated, simulated.course):
        with pytest.raises(AttributeError, match="to_pandas"):
            getattr(table, name)
        assert hasattr(table.to_pandas(), name)


def test_a_column_is_no_attribute_and_has_a_key(simulated: telenano.SimulatedSession) -> None:
    for table in (simulated, simulated.course):
        with pytest.raises(AttributeError, match=r"\['tip_force_n'\] is the column"):
            table.tip_force_n  # type: ignore[union-attr]  # noqa: B018
        assert not hasattr(table, "columns") and not hasattr(table, "_columns_of_another")


@pytest.mark.parametrize("key", [0, slice(100), ["time_s"], None, ("time_s", 0)])
def test_rows_and_slices_are_of_pandas(key: Any, simulated: telenano.SimulatedSession) -> None:
    with pytest.raises(KeyError, match="to_pandas"):
        simulated[key]


@pytest.mark.parametrize(
    ("name", "says"), [("tip_force", "tip_force_n"), ("Tip_Force_N", "tip_force_n"), ("TIME", "time_s")]
)
def test_a_wrong_column_is_answered_with_the_right_one(
    name: str, says: str, simulated: telenano.SimulatedSession
) -> None:
    with pytest.raises(KeyError, match=f"did you mean {says}"):
        simulated[name]


def test_a_part_of_the_name_of_a_channel_means_all_that_begin_with_it(simulated: telenano.SimulatedSession) -> None:
    with pytest.raises(TelenanoError, match="did you mean afm/state"):
        simulated.table("AFM")
    with pytest.raises(TelenanoError, match="did you mean afm/command or afm/state"):
        telenano.open(DEMO_RECORDING).table("afm")


def test_an_unknown_name_of_the_module_is_answered_with_those_there_are() -> None:
    with pytest.raises(AttributeError, match=r"it has .*open_all, simulate"):
        telenano.load  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("law", "`.conditions.law`"),
        ("scenario", "`.conditions.scenario`"),
        ("round_trip_ms", "`.conditions.round_trip_ms`"),
        ("seed", "`.conditions.link_seed`"),
        ("sample", "`.conditions.sample`"),
        ("save", "it has "),
        ("close", "it has "),
        ("tables", "did you mean table?"),
    ],
)
def test_an_unknown_attribute_is_answered_with_what_there_is(
    name: str, says: str, simulated: telenano.SimulatedSession
) -> None:
    with pytest.raises(AttributeError) as raised:
        getattr(simulated, name)
    assert says in str(raised.value)


@pytest.mark.parametrize("call", [np.asarray, pandas.DataFrame])
def test_a_session_is_not_taken_for_the_names_of_its_columns(call: Any, simulated: telenano.SimulatedSession) -> None:
    with pytest.raises(TypeError, match="to_pandas"):
        call(simulated)


@pytest.mark.parametrize("law", [["wave"], {"wave": 1}, 3])
def test_a_law_of_a_wrong_type_is_answered_with_the_names(law: Any) -> None:
    with pytest.raises(ConfigError, match=r"controller\.law: .*'wave'"):
        telenano.simulate("fig12", law=law)


def test_a_picture_of_columns_has_a_panel_for_each(simulated: telenano.SimulatedSession) -> None:
    panels = simulated.plot("tip_force_n", "in_contact").axes
    assert [axes.get_ylabel() for axes in panels] == ["tip_force (N)", "in_contact"]
    with pytest.raises(KeyError, match="did you mean tip_force_n"):
        simulated.plot("tip_force")
