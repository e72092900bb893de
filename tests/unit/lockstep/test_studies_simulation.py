"""`telenano.simulate`: a session in lockstep, with units and a verdict, and the errors of what cannot be one."""

import logging
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import telenano
from telenano.analysis.summary import Summary
from telenano.lockstep import lockstep
from telenano.wire.errors import ConfigError


@pytest.fixture(scope="module")
def fig12() -> telenano.SimulatedSession:
    return telenano.simulate(round_trip_ms=0.0)


def test_the_session_is_that_of_the_paper(fig12: telenano.SimulatedSession) -> None:
    assert fig12.verdict == "stable"
    hold = (fig12["time_s"] > 2.2) & (fig12["time_s"] < 2.5)
    ratio = fig12["operator_force_n"][hold] / fig12["scaled_tip_force_n"][hold]
    # 1 + 1/K_f
    assert ratio.mean() == pytest.approx(1.05, rel=1e-3)
    assert 100.0 * fig12["reference_m"][-500:].mean() == pytest.approx(0.703, rel=2e-3)


def test_the_summary_has_the_keys_of_a_recording_as_far_as_a_lockstep_has_them(
    fig12: telenano.SimulatedSession, recording_of: Callable[..., Path]
) -> None:
    recorded = telenano.open(recording_of()).summary
    # Every key fits the model of the summary of a recording.
    both = Summary.model_validate({**recorded, **fig12.summary}).model_dump(exclude_unset=True)
    assert {name: both[name] for name in fig12.summary} == fig12.summary
    assert (fig12.summary["verdict"], fig12.summary["reason"]) == (fig12.verdict, fig12.reason)
    assert fig12.summary["hold_ratio"] == pytest.approx(1.05, rel=1e-6)
    assert fig12.summary["contact_x_cm"] == pytest.approx(0.703, rel=2e-3)
    assert [hold["hold_ratio"] for hold in fig12.summary["holds"]] == [hold.hold_ratio for hold in fig12.holds]
    assert not {"recording", "seq_gaps", "loop_age_ms"} & set(fig12.summary)


def test_columns_have_units_and_one_length(fig12: telenano.SimulatedSession) -> None:
    assert {values.shape for values in fig12.values()} == {(8000,)}
    assert (fig12.units["time_s"], fig12.units["scaled_tip_force_n"]) == ("s", "N")
    assert set(fig12.units) == set(fig12.descriptions) == set(fig12)
    assert np.diff(fig12["time_s"]) == pytest.approx(1e-3)
    with pytest.raises(KeyError, match="no column 'force'; its columns are time_s"):
        fig12["force"]
    assert fig12.to_pandas().attrs["units"]["tip_force_n"] == "N"


@pytest.mark.check("takes 2 s")
def test_delay_is_what_was_asked_for_half_of_it_each_way() -> None:
    ringing = telenano.simulate(round_trip_ms=60.0)
    assert ringing.verdict != "stable"
    assert ringing.conditions.round_trip_ms == 60.0
    assert "virtual_impedance, round trip 60 ms" in ringing.conditions.title()
    ways = {f"delay_node.{way}.delay_s": 0.03 for way in ("forward", "backward")}
    each_way = telenano.simulate(settings=ways)
    for name in ringing:
        assert np.array_equal(ringing[name], each_way[name], equal_nan=ringing[name].dtype.kind == "f")


@pytest.mark.check("takes 2 s")
def test_a_network_that_jitters_is_named_with_the_round_trip_that_it_had() -> None:
    jittery = telenano.simulate(
        settings={"delay_node.forward.delay_s": 0.02, "delay_node.forward.jitter.scale_s": 0.002}
    )
    assert jittery.conditions.link_profile == "custom"
    assert "link custom" in repr(jittery) and "round trip 0 ms" not in repr(jittery)
    # newer signals overtake those that were held up, so that the mean of what is felt is less
    assert jittery.conditions.round_trip_ms == 20.0
    assert jittery.measured_round_trip_ms is not None and 10.0 < jittery.measured_round_trip_ms < 20.0


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"law": "telepathy"}, "controller.law: Input should be"),
        ({"settings": {"afm_node.rest_distance_m": -1.0}}, "afm_node.rest_distance_m"),
        ({"settings": {"haptic_node.driver": "serial",
                       "haptic_node.serial": {"port": "x", "calibration": "y"}}}, "only `up` can run it"),
        ({"operator": {"kind": "robot"}}, "haptic_node.operator"),
    ],
)  # fmt: skip
def test_what_cannot_be_simulated_says_why(given: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        telenano.simulate(**given)  # type: ignore[arg-type]


LOOP_OF_CALLS = """
import hashlib, sys, telenano
from telenano.analysis.summary import Summary
from telenano.lockstep import lockstep
lockstep.PLAIN_TICKS, calls = map(int, sys.argv[1:])
for _ in range(calls):
    done = telenano.simulate(duration_s=0.3)
    print("numba" in sys.modules, hashlib.sha256(done["scaled_tip_force_n"].tobytes()).hexdigest())
"""


@pytest.mark.endurance("compiles the loop in a folder of its own")
def test_a_call_is_plain_python_until_a_loop_of_calls_pays_for_compiling_and_what_is_kept_is_used(
    tmp_path: Path,
) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    environment["NUMBA_CACHE_DIR"] = str(tmp_path)

    def calls(*given: int) -> tuple[list[str], str]:
        command = [sys.executable, "-c", LOOP_OF_CALLS, *map(str, given)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.split(), done.stderr

    (imported, digest), said = calls(lockstep.PLAIN_TICKS, 1)
    assert (imported, said) == ("False", "")
    assert not list(tmp_path.rglob("*.nbi"))
    # 100 ticks before the session, and 300 of it: the third call compiles
    looped, said = calls(800, 3)
    assert looped == ["False", digest, "False", digest, "True", digest]
    assert said.count("compiling models") == said.count("\n") == 1
    assert calls(lockstep.PLAIN_TICKS, 1) == (["True", digest], "")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the calls that ask for compiled code, each of which runs as plain Python."""
    found: list[Any] = []

    def called(step: Any, given: Any) -> Any:
        found.append(given)
        return step(*given)

    monkeypatch.setattr(lockstep, "_plain_ticks", Counter())
    monkeypatch.setattr(lockstep, "is_compiled", lambda step, given: False)
    monkeypatch.setattr(lockstep, "compiled_call", called)
    return found


def test_ticks_are_counted_for_each_law_and_environment(asked: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    # two sessions of one kind, each with the way of the tip before it, take more than these
    monkeypatch.setattr(lockstep, "PLAIN_TICKS", 200)
    for law, environment in [("wave", "tip_sample"), ("wave", "spring"), ("passivity", "tip_sample")] * 2:
        telenano.simulate(law=law, environment=environment, round_trip_ms=0.0, duration_s=0.02)
    assert asked == []
    telenano.simulate(law="wave", round_trip_ms=0.0, duration_s=0.02)
    assert len(asked) == 1
    # what is kept is used from the first call on
    monkeypatch.setattr(lockstep, "is_compiled", lambda step, given: True)
    telenano.simulate(law="passivity", environment="spring", duration_s=0.02)
    assert len(asked) == 2


def test_a_loop_of_calls_whose_models_cannot_be_compiled_goes_on_as_plain_python(
    asked: list[Any], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refused(step: Any, given: Any) -> Any:
        asked.append(given)
        raise ConfigError("a model of this session cannot be compiled: x")

    monkeypatch.setattr(lockstep, "compiled_call", refused)
    monkeypatch.setattr(lockstep, "PLAIN_TICKS", 1)
    with caplog.at_level(logging.WARNING, "studies"):
        first, *others = (telenano.simulate(duration_s=0.02)["tip_force_n"] for _ in range(3))
    assert all(np.array_equal(first, other) for other in others)
    assert len(asked) == 1
    assert caplog.messages == ["a model of this session cannot be compiled: x; it runs as plain Python"]
