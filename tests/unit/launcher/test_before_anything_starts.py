"""What a plan finds before anything starts: a map that is not there, a line longer than the session, a mistyped key."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer

from telenano.cli.commands import session
from telenano.launcher import scenario_keys
from telenano.launcher.plan import UpRequest, make_plan
from telenano.launcher.scenario_keys import all_keys, with_meant
from telenano.wire.errors import ConfigError


@pytest.fixture(scope="module")
def keys() -> list[scenario_keys.Key]:
    return all_keys()


@pytest.fixture
def known(keys: list[scenario_keys.Key], monkeypatch: pytest.MonkeyPatch) -> None:
    """All keys, which take most of a second, are asked for once."""
    monkeypatch.setattr(scenario_keys, "all_keys", lambda: keys)


def refusal_of(tmp_path: Path, *settings: str, **request: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        make_plan(UpRequest(scenario="fig12", settings=settings, **request), tmp_path / "out")
    return str(caught.value)


def test_a_map_that_is_not_there_or_is_none_is_named_with_its_key(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("no map")
    for name, why in (("absent.npz", "cannot be read: No such file or directory"), ("text.npz", "")):
        said = refusal_of(tmp_path, f"afm_node.sample.map={tmp_path / name}")
        assert f"fig12 + --set: afm_node.sample.map: {tmp_path / name}: {why}" in said
        assert "\n" not in said


@pytest.mark.parametrize(
    ("given", "is_refused"),
    [
        ({"round_trip_ms": 60e3}, True),
        ({"round_trip_ms": 3e3, "duration_s": 3.0}, True),
        ({"round_trip_ms": 2.9e3, "duration_s": 3.0}, False),
        ({"settings": ("delay_node.backward.delay_s=9",)}, True),
        ({"settings": ("delay_node.backward.delay_s=9", "duration_s=10")}, False),
    ],
)
def test_a_delay_longer_than_the_session_is_a_sentence(given: dict[str, Any], is_refused: bool, tmp_path: Path) -> None:
    request = UpRequest(scenario="fig12", **given)
    if not is_refused:
        make_plan(request, tmp_path / "out")
        return
    with pytest.raises(ConfigError, match=r"the link delays by .* and the session lasts .*: no answer would arrive"):
        make_plan(request, tmp_path / "out")


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("controller.K_f", "controller.virtual_impedance.force_gain or controller.smith.force_gain"),
        ("force_gain", "controller.virtual_impedance.force_gain or controller.smith.force_gain"),
        ("haptic_node.force_gain", "controller.virtual_impedance.force_gain or controller.smith.force_gain"),
        ("law", "controller.law"),
        ("delay_node.delay_s", "delay_node.forward.delay_s or delay_node.backward.delay_s"),
        ("foward.delay_s", "delay_node.forward"),
        ("sample.name", "afm_node.sample"),
        ("controller.virtual_impedance.force_gan", "force_gain"),
        ("haptic_node.force_gian", "controller.virtual_impedance.force_gain or controller.smith.force_gain"),
        ("nothing_like_it", ""),
    ],
)
@pytest.mark.usefixtures("known")
def test_the_key_that_was_meant_is_looked_for_in_all_sections(key: str, meant: str, tmp_path: Path) -> None:
    said = refusal_of(tmp_path, f"{key}=2")
    assert "unknown key" in said
    assert said.partition("did you mean ")[2].partition("? Known are ")[0] == meant
    assert said.count("did you mean") == bool(meant)


@pytest.mark.usefixtures("known")
def test_each_key_is_found_by_its_last_word_from_the_wrong_section(keys: list[scenario_keys.Key]) -> None:
    missed = []
    names = [key.name for key in keys if key.name.count(".") > 1]
    for name in names[:: max(1, len(names) // 20)]:
        word = name.rpartition(".")[2]
        said = with_meant(f"x.yaml: recorder.{word}: unknown key, known are a, b")
        meant = said.partition("did you mean ")[2].partition("?")[0].split(" or ")
        if not any(each.endswith(f".{word}") for each in meant):
            missed.append(name)
    assert missed == []


@pytest.mark.parametrize(
    ("target", "answers", "code"),
    [
        ("*", {"afm_node@slave": ("ack", "set"), "controller@master": ("refused", "x: unknown key, known are a")}, 0),
        ("*", {"afm_node@slave": ("ack", "set"),
               "recorder@master": ("refused", "x cannot be set: settable are record")}, 0),
        ("*", {"afm_node@slave": ("refused", "x: unknown key"), "controller@master": ("refused", "x: unknown key")}, 1),
        ("*", {"afm_node@slave": ("ack", "set"), "delay_node@master": ("refused", "x: must be above 0")}, 1),
        ("*", {"afm_node@slave": ("ack", "set"),
               "delay_node@master": ("refused", "x: unknown key\ny: must be above 0")}, 1),
        ("afm_node@slave", {"afm_node@slave": ("refused", "x: unknown key")}, 1),
    ],
)  # fmt: skip
def test_a_setting_without_a_target_succeeds_where_those_who_have_the_key_obeyed(
    target: str, answers: dict[str, tuple[str, str]], code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    events = {src: SimpleNamespace(src=src, kind=kind, text=text) for src, (kind, text) in answers.items()}
    monkeypatch.setattr(session, "send_control", lambda *_, **__: events)
    try:
        session.send_command("set", ["x=1"], target, None, as_json=True)
        found = 0
    except typer.Exit as end:
        found = end.exit_code
    assert found == code
