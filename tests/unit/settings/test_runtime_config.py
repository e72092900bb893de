"""Every error of a configuration names where it came from, the key, and what would be right."""

import re
from pathlib import Path
from typing import Annotated, Any

import pytest
import yaml
from pydantic import BaseModel, ConfigDict, Field

from telenano.files.yaml_text import YamlError, yaml_value
from telenano.settings.config import (
    environment_overrides,
    flag_overrides,
    layered,
    merge,
    nested,
    read_yaml,
    validate,
)
from telenano.settings.scenario import Scenario
from telenano.wire.errors import ConfigError


class Strict(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Spring(Strict):
    stiffness_n_per_m: Annotated[float, Field(gt=0.0, le=1e6)]
    rest_m: float = 0.0


class Rig(Strict):
    spring: Spring
    path_m: tuple[float, ...] = ()
    count: int = 1
    word: str = "on"
    maybe: Spring | None = None


def written(folder: Path, text: str) -> Path:
    path = folder / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def error_of(model: type[BaseModel], data: dict[str, Any], section: str = "") -> str:
    with pytest.raises(ConfigError) as caught:
        validate(model, data, "rig.yaml", section)
    return str(caught.value)


def test_file_environment_and_flags_are_laid_over_one_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, "spring: {stiffness_n_per_m: 1.0, rest_m: 2.0}\ncount: 3\nword: a\n")
    monkeypatch.setenv("TELENANO__SPRING__STIFFNESS_N_PER_M", "10.0")
    monkeypatch.setenv("TELENANO__COUNT", "4")
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/not/a/key")
    document, origin = layered(path, ["count=5", "path_m=[1.0, 2e-9]"])
    rig = validate(Rig, document, origin)
    assert rig == Rig(spring=Spring(stiffness_n_per_m=10.0, rest_m=2.0), path_m=(1.0, 2e-9), count=5, word="a")
    assert origin == f"{path} + environment + --set"
    monkeypatch.delenv("TELENANO__SPRING__STIFFNESS_N_PER_M")
    monkeypatch.delenv("TELENANO__COUNT")
    assert layered(path)[1] == str(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.yaml: cannot be read: No such file"):
        read_yaml(tmp_path / "absent.yaml")
    with pytest.raises(ConfigError, match=re.escape(f"{tmp_path}: cannot be read: Is a directory")):
        read_yaml(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("spring: {stiffness", "is not valid YAML: .*line 1"),
        ("a: b: c", "is not valid YAML: .*line 1"),
        ("- 1\n- 2", "contains a list, must contain a mapping of keys"),
        ("", "contains a NoneType, must contain a mapping"),
        ("just words", "contains a str"),
        ("a: !!python/object/apply:os.getcwd []", "is not valid YAML: .*could not determine a constructor"),
        ("a: 1\nb:\n  c: 1\n  c: 2\n", "is not valid YAML: b.c is given twice, the second time in line 4"),
        ("nodes: {a: [1, {c: 1, 'c': 2}]}", "is not valid YAML: nodes.a.1.c is given twice, the second time in line 1"),
        ("true: 1\nTrue: 2", "is not valid YAML: True is given twice, the second time in line 2"),
        ("a: &x {b: 1}\nc: {<<: *x, <<: *x}", "is not valid YAML: c.<< is given twice"),
        ("? [a]\n: 1", "is not valid YAML: .*unhashable key"),
        ("a: " + "[" * 600, "is not valid YAML: it is nested too deeply"),
        ("a: \x00", "is not valid YAML"),
        (
            "duration_s: 012",
            "is not valid YAML: 012 in line 1 is not a number of base 10: write 12, or '012' for a text",
        ),
        ("a: 1\nseed: -0100", "is not valid YAML: -0100 in line 2 is not a number of base 10: write -100"),
        (
            "d: 1:30",
            "is not valid YAML: 1:30 in line 1 is not a number of base 10: write 90 for that number of seconds",
        ),
        ("d: [1:02:03.5]", "is not valid YAML: 1:02:03.5 in line 1 is not a number of base 10: write 3723.5"),
        ("d: 0x1F", "is not valid YAML: 0x1F in line 1 is not a number of base 10: write 31, or '0x1F' for a text"),
        ("d: 0o17", "is not valid YAML: 0o17 .*: write 15"),
        ("d: 0b11", "is not valid YAML: 0b11 .*: write 3"),
        ("d: [007, 008]", "is not valid YAML: 007 .*: write 7"),
        ("d: 00.5", "is not valid YAML: 00.5 .*: write 0.5"),
    ],
)
def test_what_is_not_a_mapping_in_yaml_is_refused_with_its_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=rf"rig\.yaml: {message}") as caught:
        read_yaml(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_what_is_not_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_bytes(b"a: \xff\xfe")
    with pytest.raises(ConfigError, match=r"rig\.yaml: is not UTF-8 text \(byte 3\)"):
        read_yaml(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-9", 1e-9),
        ("-2E+3", -2e3),
        (".5e-3", 0.5e-3),
        ("1.5e-9", 1.5e-9),
        ("1.0", 1.0),
        ("12", 12),
        ("on", "on"),
        ("off", "off"),
        ("no", "no"),
        ("true", True),
        ("False", False),
        ("trueish", "trueish"),
        ("1e", "1e"),
        ("e5", "e5"),
        ("1e-9 m", "1e-9 m"),
        ("null", None),
        ("[1e-9, 2]", [1e-9, 2]),
    ],
)
def test_numbers_and_words_are_read_as_people_mean_them(tmp_path: Path, text: str, value: object) -> None:
    for found in (
        read_yaml(written(tmp_path, f"a: {text}"))["a"],
        flag_overrides([f"a={text}"])["a"],
        environment_overrides({"TELENANO__A": text})["a"],
    ):
        assert found == value
        assert type(found) is type(value)


def test_the_reader_of_other_programs_is_left_as_it_is() -> None:
    assert yaml.safe_load("[1e-9, on]") == ["1e-9", True]


def test_an_unknown_key_lists_the_known_ones() -> None:
    assert error_of(Rig, {"spring": {"stiffness_n_per_m": 1.0, "stifness": 2.0}}) == (
        "rig.yaml: spring.stifness: unknown key, known are stiffness_n_per_m, rest_m"
    )
    good = {"stiffness_n_per_m": 1.0}
    assert error_of(Rig, {"spring": good, "sprung": 1}, "afm_node") == (
        "rig.yaml: afm_node.sprung: unknown key, did you mean spring? Known are spring, path_m, count, word, maybe"
    )
    # below an alternative the right keys are not certain: the key is named all the same
    assert "maybe.x: unknown key" in error_of(Rig, {"spring": good, "maybe": {**good, "x": 1}})


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.0, "Input should be greater than 0 (allowed is from above 0 to 1e+06), got 0.0"),
        (-1.0, "greater than 0 (allowed is from above 0 to 1e+06), got -1.0"),
        (2e6, "less than or equal to 1000000 (allowed is from above 0 to 1e+06), got 2000000.0"),
        (float("nan"), "got nan"),
        (float("inf"), "got inf"),
        ("soft", "valid number in N/m, got 'soft'"),
        (True, "valid number, got True"),
        (None, "valid number, got None"),
        ([1.0], "valid number"),
    ],
)
def test_a_value_out_of_range_or_of_a_wrong_kind_is_named(value: object, message: str) -> None:
    text = error_of(Rig, {"spring": {"stiffness_n_per_m": value}}, "haptic_node")
    assert text.startswith("rig.yaml: haptic_node.spring.stiffness_n_per_m: ")
    assert message in text


def test_nan_is_refused_where_no_range_would_do_it() -> None:
    text = error_of(Rig, {"spring": {"stiffness_n_per_m": 1.0, "rest_m": float("nan")}})
    assert text == "rig.yaml: spring.rest_m: Input should be a finite number, got nan"


def test_every_fault_has_a_line() -> None:
    text = error_of(Rig, {"spring": {"rest_m": "far"}, "count": 1.5, "path_m": [0.0, "x"]})
    assert text.splitlines() == [
        "rig.yaml: spring.stiffness_n_per_m: is missing",
        "rig.yaml: spring.rest_m: Input should be a valid number in m, got 'far'",
        "rig.yaml: path_m.1: Input should be a valid number, got 'x'",
        "rig.yaml: count: Input should be a valid integer, got 1.5",
    ]


def test_a_date_is_refused_at_its_key(tmp_path: Path) -> None:
    document = read_yaml(written(tmp_path, "spring: {stiffness_n_per_m: 2026-01-01}"))
    assert error_of(Rig, document) == (
        "rig.yaml: spring.stiffness_n_per_m: Input should be a valid number in N/m, got '2026-01-01'"
    )


def test_a_document_that_contains_itself_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"rig.yaml: is not valid YAML: the value in line 2 is part of itself"):
        read_yaml(written(tmp_path, "b: 1\na: &a [*a]"))


@pytest.mark.parametrize("flag", ["spring", "=1", ""])
def test_a_flag_of_another_form_is_named(flag: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"--set {flag}: is not of the form section.key=value")):
        flag_overrides([flag])


def test_flags_and_variables_nest() -> None:
    assert flag_overrides(["a.b.c=1", "a.b.d=x=y", "e={f: 2}"]) == {"a": {"b": {"c": 1, "d": "x=y"}}, "e": {"f": 2}}
    assert environment_overrides({"TELENANO__A__B_M": "1", "HOME": "/"}) == {"a": {"b_m": 1}}
    assert nested({"a.b": 1, "a.c": None}, "somewhere") == {"a": {"b": 1, "c": None}}


def test_a_key_that_is_both_value_and_section_is_refused() -> None:
    for attempt in (
        lambda: flag_overrides(["a=1", "a.b=2"]),
        lambda: environment_overrides({"TELENANO__A": "1", "TELENANO__A__B": "2"}),
        lambda: nested({"a": 1, "a.b": 2}, "session/control x"),
    ):
        with pytest.raises(ConfigError, match="a already has a value"):
            attempt()


def test_a_value_that_is_not_yaml_is_named_with_its_flag_or_variable() -> None:
    with pytest.raises(ConfigError, match=r"--set a=\{: the value is not valid YAML"):
        flag_overrides(["a={"])
    with pytest.raises(ConfigError, match="environment variable TELENANO__A: the value is not valid YAML"):
        environment_overrides({"TELENANO__A": "["})


def test_merging_changes_none_of_its_layers() -> None:
    below: dict[str, Any] = {"a": {"b": 1, "c": 2}, "d": [1]}
    above: dict[str, Any] = {"a": {"b": 9}, "d": [2], "e": {"f": 1}}
    assert merge(below, above) == {"a": {"b": 9, "c": 2}, "d": [2], "e": {"f": 1}}
    assert below == {"a": {"b": 1, "c": 2}, "d": [1]}
    assert merge({"a": 1}, {"a": {"b": 2}}) == {"a": {"b": 2}}
    assert merge() == {}


def test_a_key_of_very_many_parts_is_refused() -> None:
    # whoever walks through sections does so one within the other, and would run out of stack
    deep = ".".join("a" * 5000)
    for refused in (lambda: nested({deep: 1}, "session/control"), lambda: flag_overrides([f"{deep}=1"])):
        with pytest.raises(ConfigError, match="has 5000 parts, at most 16 are allowed") as caught:
            refused()
        assert len(str(caught.value)) < 12_000
    assert nested({".".join("a" * 16): 1}, "x")


def test_of_very_many_faults_the_first_are_told() -> None:
    text = error_of(Rig, {f"k{number}": 1 for number in range(1000)})
    assert len(text.splitlines()) == 21
    assert any(line.startswith("rig.yaml: k0: unknown key") for line in text.splitlines())
    # a missing key is a fault as well
    assert text.splitlines()[-1] == "rig.yaml: and 981 more"


def test_a_mapping_of_another_kind_takes_the_place_of_the_one_before() -> None:
    below = {"operator": {"kind": "force_profile", "points": [1]}, "law": "wave"}
    assert merge(below, {"operator": {"kind": "interactive"}}) == {"operator": {"kind": "interactive"}, "law": "wave"}
    more = merge(below, {"operator": {"kind": "force_profile", "max_force_n": 5.0}})
    assert more["operator"] == {"kind": "force_profile", "points": [1], "max_force_n": 5.0}
    assert merge(below, {"operator": {"max_force_n": 5.0}})["operator"]["points"] == [1]


def test_a_path_that_the_locale_cannot_express_is_named_with_the_remedy_and_without_the_document() -> None:
    class Recorder(Strict):
        directory: str

    class Whole(Strict):
        recorder: Recorder
        note: str

    # what os.fsdecode makes of "out/\xc3\xa9" under LC_ALL=POSIX with PYTHONUTF8=0
    document = {"note": "x" * 500, "recorder": {"directory": "out/\udcc3\udca9"}}
    with pytest.raises(ConfigError) as refusal:
        validate(Whole, document, "s.yaml")
    assert str(refusal.value) == (
        "s.yaml: recorder.directory: out/\\xc3\\xa9 cannot be read as text under this locale: "
        "run with PYTHONUTF8=1, or under a locale such as C.UTF-8"
    )


def test_a_long_value_is_quoted_in_part(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="duration_s: Input should be a valid number in s, got 'xxx") as error:
        validate(Scenario, {"name": "a", "description": "b", "duration_s": "x" * 100_000}, "a.yaml")
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    "text",
    [
        'name: "\\uD800"',
        '"a\\uDC00": 1',
        'deep: [1, {in: ["x", "\\uDBFF\\uDBFF"]}]',
        'one: &a ["\\uD834"]\ntwo: *a',
        '? ["\\uD800"]\n: 1',
        '!!str "\\ud800"',
    ],
)
def test_half_of_a_character_is_refused_by_its_line_wherever_it_stands(text: str) -> None:
    with pytest.raises(YamlError, match=r"in line \d is half of a character"):
        yaml_value(f"first: 1\n{text}" if text.startswith("name") else text)


def test_a_character_beyond_the_first_65536_is_one() -> None:
    assert yaml_value('name: "\\U0001D11E"') == {"name": "\U0001d11e"}
