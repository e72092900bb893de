"""The acceptance of an instrument: a good one passes, and each check finds the fault that it is for."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_devices.acceptance.instrument.checks import INSTRUMENT
from telenano_devices.acceptance.instrument.instruments import facts_of, make_take
from telenano_devices.acceptance.instrument.take import STEPS, Facts, record_take
from telenano_devices.acceptance.take import Clock, Guide, Take, Verdict, overall, read_take
from telenano_devices.doubles.controller_line import Gwyscope, Nanonis
from telenano_devices.gwyscope.gwyscope_driver import GwyscopeAfm
from telenano_devices.nanonis.nanonis_driver import NanonisAfm
from telenano_devices.t7.stage_line import StageLine, calibration

from telenano.afm import simulated_afm
from telenano.devices import ModbusAfm, read_map
from telenano.sections import AfmConfig
from telenano.testing import invoke
from telenano.wire import ConfigError

MS = 1_000_000

# near the sample, so that the approach is short
SAFETY = {"base_min_m": -30e-9, "base_max_m": 30e-9, "retract_position_m": -15e-9}
Hook = Callable[[Any, str], None]


class Behind:
    """The instrument behind an emulator: it may be moved against the sample [m], and its read-out may drift [V]."""

    def __init__(self, afm: Any) -> None:
        self._afm = afm
        self.offset_m = self.offset_v = 0.0

    def exchange(self, base_m: float) -> Any:
        sample = self._afm.exchange(base_m + self.offset_m)
        return sample._replace(bridge_voltage_v=sample.bridge_voltage_v + self.offset_v)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._afm, name)


def config(driver: str, **safety: float) -> AfmConfig:
    section = {} if driver == "simulated" else {driver: {"calibration": f"{driver}.yaml"}}
    return AfmConfig.model_validate({"driver": driver, "safety": SAFETY | safety, **section})


def line_of(driver: str, limits: Any, **changes: Any) -> Any:
    """Return an emulated instrument and its driver in virtual time."""
    if driver == "modbus":
        line: Any = StageLine()
        clock = {"connect": line.connect, "now_ns": lambda: line.now_ns}
        clock["sleep"] = lambda seconds: line.pass_ms(max(1, round(seconds * 1e3)))
        line.driver = ModbusAfm(calibration(**changes), read_map("t7"), limits, **clock)
    else:
        line = {"gwyscope": Gwyscope, "nanonis": Nanonis}[driver](**changes)
        line.driver = {"gwyscope": GwyscopeAfm, "nanonis": NanonisAfm}[driver](line.calibration, limits, **line.clock)
    line.model._afm = Behind(line.model._afm)
    return line


def take_of(
    driver: str, hook: Hook = lambda line, step: None, *, safety: Any = None, stiff: bool = False, **changes: Any
) -> Take[Facts]:
    """Make a take; the hook is called each millisecond with the line and the name of the step."""
    chosen = config(driver, **(safety or {}))
    if stiff:
        sample = AfmConfig.model_validate({"tip_sample": {"sample_modulus_pa": 1e13, "tip_modulus_pa": 1e13}})
        changes["afm"] = simulated_afm(sample.to_params())
    if driver == "simulated":
        return make_take(chosen)
    limits, step = chosen.to_params().safety, [""]
    line = line_of(driver, limits, **changes)
    line.driver.open()

    def wait(deadline_ns: int) -> None:
        while line.now_ns < deadline_ns:
            line.pass_ms(1)
            hook(line, step[0])

    clock = Clock(lambda: line.now_ns, wait)
    facts = facts_of(chosen, line.driver)
    return record_take(line.driver, facts, clock, Guide(lambda begun: step.__setitem__(0, begun.name)))


def found(take: Take[Facts]) -> dict[str, Verdict]:
    return {verdict.check: verdict for verdict in INSTRUMENT.judge(take)}


@pytest.fixture(scope="module")
def good() -> Take[Facts]:
    return take_of("gwyscope")


def test_every_check_passes_on_a_good_controller_and_a_take_is_judged_again(good: Take[Facts], tmp_path: Path) -> None:
    verdicts = INSTRUMENT.judge(good)
    assert [verdict for verdict in verdicts if verdict.result != "pass"] == []
    assert overall(verdicts) == "pass"
    assert [verdict.check for verdict in verdicts] == list(ALTERED)
    # with a step of 3 ms the latency is the declared one
    assert float(found(good)["latency"].found.split()[0]) == pytest.approx(4.0, abs=2.0)
    good.save(tmp_path / "take.npz")
    _, take = read_take(tmp_path / "take.npz", INSTRUMENT)
    assert take.facts == good.facts and INSTRUMENT.judge(take) == verdicts


def changed(take: Take[Facts], step: str, name: str, change: Callable[[Any], Any]) -> Take[Facts]:
    rows = take.rows.copy()
    chosen = rows["step"] == [each.name for each in STEPS].index(step)
    rows[name][chosen] = change(rows[name][chosen])
    return take._replace(rows=rows)


# rows of a good take that are altered, for every check
ALTERED: dict[str, Callable[[Take[Facts]], Take[Facts]]] = {
    "losses": lambda take: changed(take, "range", "status", lambda old: old * 0 + 2),
    "rate of samples": lambda take: changed(take, "approach", "fresh", lambda old: old // 2),
    "age of samples": lambda take: take._replace(rows=_older(take.rows, 5e-3)),
    "gaps": lambda take: changed(take, "range", "age_s", lambda old: np.where(np.arange(len(old)) == 5, 0.2, old)),
    "range of the input": lambda take: changed(take, "contact", "in_range", lambda old: old & False),
    "noise at rest": lambda take: changed(
        take, "rest", "force_n", lambda old: old + np.random.default_rng(1).normal(0.0, 1e-9, len(old))
    ),
    "drift at rest": lambda take: changed(take, "rest", "force_n", lambda old: np.linspace(0.0, 1e-9, len(old))),
    "zero at rest": lambda take: changed(take, "rest", "force_n", lambda old: old + 2e-9),
    "range of the base": lambda take: changed(take, "range", "base_m", lambda old: 0.8 * old),
    "surface": lambda take: take._replace(rows=take.rows[take.rows["step"] < 3]),
    "sign of the force": lambda take: changed(take, "contact", "force_n", lambda old: 0.0 - old),
    "scale of the force": lambda take: changed(take, "contact", "force_n", lambda old: 4.0 * old),
    "latency": lambda take: changed(take, "contact", "force_n", lambda old: np.roll(old, 6)),
    "limit of the force": lambda take: changed(take, "contact", "force_n", lambda old: old + 1e-6),
    "watchdog": lambda take: take._replace(facts=take.facts._replace(retractions=(3, 3))),
    "coming back": lambda take: changed(take, "back", "status", lambda old: old * 0 + 2),
}


def _older(rows: Any, by_s: float) -> Any:
    rows = rows.copy()
    rows["age_s"] += by_s
    return rows


@pytest.mark.parametrize("name", list(ALTERED))
def test_each_check_finds_what_a_take_shows(good: Take[Facts], name: str) -> None:
    verdict = found(ALTERED[name](good))[name]
    assert verdict.result == ("retake" if name == "surface" else "fail"), verdict


def test_a_take_without_a_guard_and_one_of_a_soft_sample_cannot_say(good: Take[Facts]) -> None:
    attended = good._replace(facts=good.facts._replace(heartbeat_s=0.0, retractions=(None, None)))
    assert found(attended)["watchdog"].result == "cannot say"
    soft = changed(good, "contact", "force_n", lambda old: 0.1 * old)
    assert found(soft)["scale of the force"].result == "cannot say"


def test_a_driver_of_a_package_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    other = AfmConfig().model_copy(update={"driver": "somebodys_afm"})
    with pytest.raises(ConfigError, match="somebodys_afm declares no capabilities"):
        make_take(other)


# --- faults that are put into the instruments


def halting(line: Any, step: str) -> None:
    line.model.stands = line.now_ns // (20 * MS) % 2 == 0


def interrupted(line: Any, step: str) -> None:
    if step == "range" and not hasattr(line, "cut_off"):
        line.cut_off = True
        line.close()


def noisy(line: Any, step: str) -> None:
    line.model._afm.offset_v = 3e-4 * math.sin(line.now_ns * 1e-9 * 331.0)


def drifting(line: Any, step: str) -> None:
    line.model._afm.offset_v += 1e-7


def struck(line: Any, step: str) -> None:
    line.model._afm.offset_m = 2e-8 if step == "contact" else 0.0


def unguarded(line: Any, step: str) -> None:
    line.judge.judge = lambda now_ns, *, connected: False


def gone(line: Any, step: str) -> None:
    line.reachable = step != "back"


def slow(line: Any, step: str) -> None:
    line.latency_ms = 8.0


def stuck_far(line: Any, step: str) -> None:
    if not hasattr(line, "usual"):
        line.usual = line.model._move_z
        near_m = 2.0e-6 - 20e-9
        line.model._move_z = lambda z_m: line.usual(near_m if 1.0e-6 < z_m < near_m else z_m)


def without_script(line: Any, step: str) -> None:
    if step == "silence":
        line.model.script._stepped_ns = None


FAULTS: dict[str, tuple[str, dict[str, Any]]] = {
    "losses": ("gwyscope", {"hook": interrupted}),
    "rate of samples": ("gwyscope", {"hook": halting}),
    "age of samples": ("gwyscope", {"hook": slow}),
    "gaps": ("nanonis", {"hook": interrupted}),
    "range of the input": ("gwyscope", {"deflection": {"limit": 1e-3}}),
    "noise at rest": ("nanonis", {"hook": noisy, "logger_port": 6590}),
    "drift at rest": ("nanonis", {"hook": drifting}),
    "zero at rest": ("modbus", {"deflection": {"zero_v": 5e-4}}),
    "range of the base": ("gwyscope", {"hook": stuck_far, "z": {"tolerance_m": 1e-6}}),
    "surface": ("nanonis", {"safety": {"base_max_m": 5e-9}}),
    "sign of the force": ("modbus", {"deflection": {"v_per_m": -6.25e6}}),
    "scale of the force": ("nanonis", {"deflection": {"per_m": 3.125e6}, "stiff": True}),
    "latency": ("gwyscope", {"hook": slow}),
    "limit of the force": ("gwyscope", {"hook": struck}),
    "watchdog": ("gwyscope", {"hook": unguarded}),
    "coming back": ("gwyscope", {"hook": gone}),
}


@pytest.mark.endurance
@pytest.mark.parametrize("name", list(ALTERED))
def test_each_check_finds_the_fault_that_is_put_in(name: str) -> None:
    driver, given = FAULTS[name]
    verdict = found(take_of(driver, **given))[name]
    assert verdict.result == ("retake" if name == "surface" else "fail"), verdict


@pytest.mark.endurance
@pytest.mark.parametrize(
    ("driver", "hook", "check"),
    [
        ("nanonis", unguarded, "watchdog"),
        ("modbus", without_script, "watchdog"),
        ("nanonis", slow, "latency"),
        ("modbus", slow, "latency"),
        ("modbus", noisy, "noise at rest"),
    ],
)
def test_faults_of_the_other_instruments_are_found_too(driver: str, hook: Hook, check: str) -> None:
    assert found(take_of(driver, hook))[check].result == "fail"


@pytest.mark.endurance
@pytest.mark.parametrize("driver", ["simulated", "modbus", "gwyscope", "nanonis"])
def test_every_good_instrument_passes(driver: str) -> None:
    verdicts = found(take_of(driver))
    wanted = {"watchdog": "cannot say"} if driver == "simulated" else {}
    assert {name: verdict.result for name, verdict in verdicts.items()} == {
        name: wanted.get(name, "pass") for name in verdicts
    }


@pytest.mark.endurance
def test_a_wrong_sign_of_z_is_found_before_anything_approaches() -> None:
    # the file says that a smaller z is nearer; what it takes for retracted is deep in the sample
    z = {"towards_sample": -1, "retract_m": 4.0e-6, "rest_m": 2.0e-6, "unsafe_wiring_acknowledged": True}
    take = take_of("gwyscope", z=z)
    verdicts = found(take)
    assert verdicts["zero at rest"].result == "fail", verdicts["zero at rest"]
    assert not len(take.of("approach"))
    assert "in the step rest" in take.facts.stopped


def test_the_command_judges_the_simulated_instrument_and_writes_page_and_verdicts(tmp_path: Path) -> None:
    settings = [word for key, value in SAFETY.items() for word in ("--set", f"afm_node.safety.{key}={value}")]
    out = tmp_path / "accept"
    result = invoke(["device", "accept", "--json", "--out", str(out), *settings])
    assert result.exit_code == 0, result.output
    document = json.loads(result.output)
    assert document == json.loads((out / "accept.json").read_text())
    assert {check["result"] for check in document["checks"]} == {"pass", "cannot say"}
    assert "Acceptance of the simulated instrument: pass" in (out / "accept.html").read_text()
    again = invoke(["device", "accept", "--from", str(out / "take.npz"), "--out", str(tmp_path / "again")])
    assert again.exit_code == 0
    assert "pass: the simulated instrument" in again.output
