from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import BaseModel, ConfigDict, Field

from telenano.settings.scenario import LoadedScenario, RealtimeConfig, Scenario
from telenano.wire.errors import ConfigError

GOOD = """
name: fig12
description: press and release
duration_s: 8.0
realtime: {scheduler: normal, memory_lock: off}
afm_node: {gap_m: 1e-8}
"""


class Section(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    gap_m: Annotated[float, Field(ge=0.0, le=1.0)]
    ambient: bool = True


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "fig12.yaml"
    file.write_text(GOOD, encoding="utf-8")
    return file


def test_a_scenario_and_its_sections(path: Path) -> None:
    loaded = LoadedScenario.load(path)
    assert (loaded.scenario.name, loaded.scenario.duration_s, loaded.origin) == ("fig12", 8.0, str(path))
    assert loaded.scenario.realtime == RealtimeConfig(scheduler="normal", memory_lock="off")
    assert loaded.section("afm_node", Section) == Section(gap_m=1e-8)
    assert loaded.document["afm_node"] == {"gap_m": 1e-8}


def test_flags_and_environment_reach_a_section(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO__AFM_NODE__AMBIENT", "false")
    loaded = LoadedScenario.load(path, ["afm_node.gap_m=2e-8", "duration_s=1.5"])
    assert loaded.section("afm_node", Section) == Section(gap_m=2e-8, ambient=False)
    assert loaded.scenario.duration_s == 1.5
    assert loaded.origin == f"{path} + environment + --set"


@pytest.mark.parametrize(
    ("flag", "message"),
    [
        ("duration_s=0.0", "duration_s: Input should be greater than 0 (allowed is from above 0 to 86400), got 0.0"),
        ("duration_s=.nan", "duration_s: "),
        ("duration_s=.inf", "duration_s: "),
        ("name=Fig 12", "name: String should match pattern"),
        (
            "duration=8.0",
            "duration: unknown key, did you mean duration_s? Known are name, description, duration_s, instrument",
        ),
        (
            "realtime.priority=99",
            "realtime.priority: Input should be less than or equal to 98 (allowed is from 1 to 98), got 99",
        ),
        ("realtime.speed=1", "realtime.speed: unknown key, known are scheduler, priority"),
        ("realtime.scheduler=fast", "realtime.scheduler: Input should be 'auto', 'fifo' or 'normal', got 'fast'"),
        ("afm_node=3", "afm_node: "),
    ],
)
def test_a_wrong_scenario_names_file_and_key(path: Path, flag: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        LoadedScenario.load(path, [flag])
    assert str(caught.value).startswith(f"{path} + --set: {message}")


@pytest.mark.parametrize(
    ("flag", "message"),
    [
        (
            "afm_node.gap_m=10.0",
            "afm_node.gap_m: Input should be less than or equal to 1 (allowed is from 0 to 1), got 10.0",
        ),
        ("afm_node.gap_m=.nan", "afm_node.gap_m: "),
        ("afm_node.gap_nm=10", "afm_node.gap_nm: unknown key, did you mean gap_m? Known are gap_m, ambient"),
    ],
)
def test_a_wrong_section_names_file_section_and_key(path: Path, flag: str, message: str) -> None:
    loaded = LoadedScenario.load(path, [flag])
    with pytest.raises(ConfigError) as caught:
        loaded.section("afm_node", Section)
    assert str(caught.value).startswith(f"{path} + --set: {message}")


def test_a_missing_section_is_an_empty_one(path: Path) -> None:
    with pytest.raises(ConfigError, match=r"recorder\.gap_m: is missing"):
        LoadedScenario.load(path).section("recorder", Section)


def test_the_dynamic_cantilever_has_the_processor_of_the_slave_without_the_link() -> None:
    facts: dict[str, Any] = {"name": "a", "description": "b", "duration_s": 1.0}
    for model, cpus, expected in (
        ("dynamic", "auto", "link_at_master"),
        ("dynamic", "free", "free"),
        ("quasi_static", "auto", "auto"),
    ):
        document = {**facts, "afm_node": {"model": model}, "realtime": {"cpus": cpus}}
        found = Scenario.model_validate(document).realtime_in_force()
        assert found.cpus == expected


class Period(BaseModel):
    period_s: float = 1e-3


@pytest.mark.parametrize(
    ("flags", "period_s"),
    [
        ((), 0.001),
        (("realtime.rate_hz=2000.0",), 0.0005),
        (("realtime.rate_hz=100.0",), 0.01),
        # whole nanoseconds, as the grid of the hand
        (("realtime.rate_hz=300.0",), 0.003333333),
        (("controller.period_s=0.002",), 0.002),
        (("controller.period_s=0.0005", "realtime.rate_hz=2000.0"), 0.0005),
    ],
)
def test_one_key_has_the_rate_of_the_whole_loop(path: Path, flags: tuple[str, ...], period_s: float) -> None:
    loaded = LoadedScenario.load(path, flags)
    assert loaded.scenario.period_s == period_s
    assert loaded.section("controller", Period).period_s == period_s


@pytest.mark.parametrize("rate", ["1000.0", "500.0"])
def test_two_keys_that_disagree_are_refused(path: Path, rate: str) -> None:
    flags = ["controller.period_s=0.0005", f"realtime.rate_hz={rate}"]
    with pytest.raises(ConfigError, match=r"controller\.period_s: 0\.0005 disagree: give realtime\.rate_hz alone"):
        LoadedScenario.load(path, flags)


@pytest.mark.parametrize("given", ["text", "true", "[1]", "-1.0", ".inf"])
def test_a_period_that_is_none_is_left_to_its_own_section(path: Path, given: str) -> None:
    loaded = LoadedScenario.load(path, [f"controller.period_s={given}", "realtime.rate_hz=500.0"])
    assert loaded.scenario.period_s == 0.002
