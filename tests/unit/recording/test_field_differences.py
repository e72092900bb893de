import pytest

from telenano.recording.field_differences import Tolerances
from telenano.wire.errors import ConfigError

LEFT = {"seq": 1, "position_m": (0.0, 0.0, -1e-9), "mode": "follow", "data": {"a": 1}}


def test_equal_messages_have_no_difference() -> None:
    assert Tolerances().first_difference(LEFT, dict(LEFT)) is None


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"position_m": (0.0, 0.0, -1.1e-9)}, "position_m.2"),
        ({"position_m": (-0.0, 0.0, -1e-9)}, "position_m.0"),
        ({"position_m": (0.0, 0.0)}, "position_m"),
        ({"mode": "hold"}, "mode"),
        ({"data": {"a": 2}}, "data.a"),
        ({"data": {"a": True}}, "data.a"),
        ({"data": {}}, "data.a"),
        ({"more": 1.0}, "more"),
    ],
)
def test_the_first_differing_field_is_named(change: dict[str, object], field: str) -> None:
    found = Tolerances().first_difference(LEFT, {**LEFT, **change})
    assert found is not None
    assert found.field == field
    assert field in found.text


def test_a_tolerance_holds_for_the_parts_of_its_field_only() -> None:
    moved = {**LEFT, "position_m": (0.0, 0.0, -1.1e-9)}
    assert Tolerances({"position_m": 1.01e-10}).first_difference(LEFT, moved) is None
    assert Tolerances({"position_m.0": 1.0}).first_difference(LEFT, moved) is not None
    assert Tolerances({"position_m": 0.99e-10}).first_difference(LEFT, moved) is not None
    assert Tolerances({"*": 1.0}).first_difference(LEFT, {**LEFT, "mode": "hold"}) is not None


def test_ignored_fields_are_left_out() -> None:
    assert Tolerances().first_difference(LEFT, {**LEFT, "seq": 2}, ("seq",)) is None


@pytest.mark.parametrize("text", ["force_n", "force_n=x", "=1", "force_n=-1", "force_n=nan"])
def test_a_wrong_tolerance_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="tolerance"):
        Tolerances.parse([text])


def test_a_tolerance_may_be_for_one_topic() -> None:
    limits = Tolerances.parse(["afm/state:position_m=1e-12", "force_n=0.5"])
    assert limits.on("afm/state").of("position_m.2") == 1e-12
    assert limits.on("haptic/state").of("position_m.2") == 0.0
    assert limits.on("haptic/state").of("force_n") == 0.5
