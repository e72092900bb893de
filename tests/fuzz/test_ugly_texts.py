"""Ugly texts wherever a stranger writes one: each is shown on one line, as text, and ends in no traceback."""

import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import yaml
from damaged_files import mcap, mcap_channel, mcap_record
from ended_commands import ended

from telenano.recording.made_records import recorded, write_recording
from telenano.wire import example

SEED = 95
SHARE = 25
MOST_S = 6.0
BEGAN_NS = 10**18
UGLY = {
    "orders of a terminal": "a\x1b]0;mine\x07\x1b[2J\x9b31m\rz",
    "line breaks": "a\nb` c\n\ntelenano: fine",
    "separators": "a\u2028b\u2029c\x85d\x0be\x0cf",
    "direction": "a\u202eb\u2066c\u200f",
    "backticks": "a`rm -rf ~`$(id)",
    "a zero": "a\0b",
    "markup": "[red]a[/red] <b> {x} %s %n",
    "long": "x" * 3000,
    "nothing": "",
    "blanks": " \t ",
    "combining": "a" + "\u0301" * 200,
    "astral": "\U0001f600\U000e0001",
    "no character": "a\ufffe\uffff",
}
HALF = '"\\uD800"'


def recording_with(folder: Path, **changed: Any) -> Path:
    """Make a recording of some events, of which the last has changed fields."""
    folder.mkdir(exist_ok=True)
    ordinary = [recorded("session/event", example("session/event"), BEGAN_NS + number) for number in range(3)]
    fields = {**msgpack.unpackb(ordinary[0].payload), **changed}
    return write_recording(folder, [*ordinary, ordinary[0]._replace(payload=msgpack.packb(fields))])


def recording_of(path: Path, topic: str) -> Path:
    """Make a recording of a channel of another program."""
    channel = mcap_channel(1, topic)
    path.write_bytes(mcap(channel, mcap_record(5, bytes([1, 0]) + bytes(20)), summary=channel))
    return path


def scenario_with(folder: Path, text: str) -> Iterator[tuple[str, list[str]]]:
    """Yield what is odd and the commands that read it, for each place of a text in a file that a person writes."""
    for place, document in {
        "a value": {"name": text},
        "a key": {text or "k": 1},
        "a deep value": {"name": "x", "haptic_node": {"operator": {"kind": text}}},
        "a deep key": {"name": "x", "haptic_node": {"operator": {text or "k": {"kind": 1}}}},
        "a list": {"name": "x", "delay_node": {"forward": {"reliable": [text]}}},
    }.items():
        path = folder / f"{place.replace(' ', '_')}.yaml"
        path.write_text(yaml.safe_dump(document, allow_unicode=False))
        yield place, ["scenario", "check", str(path)]
        yield f"{place} of a site file", ["status", "--site-file", str(path)]
        yield f"{place} of a plan", ["experiment", "check", str(path)]


def lines_of(folder: Path, text: str) -> Iterator[tuple[str, list[str]]]:
    yield from scenario_with(folder, text)
    recordings = {
        "a topic": recording_of(folder / "topic.mcap", text),
        "a text": recording_with(folder / "text", text=text),
        "a source": recording_with(folder / "source", src=text),
    }
    for place, path in recordings.items():
        for command in (["bag", "info"], ["bag", "verify"], ["bag", "cat"], ["report"], ["bag", "filter"]):
            out = ["--out", str(folder / f"{place}-{command[-1]}")] if command[-1] in ("report", "filter") else []
            yield f"{place} of a recording", [*command, str(path), *out]
        yield f"{place} of a recording", ["bag", "cat", str(path), "--topics", "none"]
    yield "a name", ["law", "show", text or " "]
    yield "a name", ["bag", "cat", str(recordings["a topic"]), "--topics", text or " "]
    yield "a setting", ["scenario", "check", "fig12", "--set", f"controller.law={text}"]
    yield "a key of a setting", ["scenario", "check", "fig12", "--set", f"{text}=1"]
    yield "a command", [text or " "]
    yield "a target", ["session", "mark", "--target", text]
    yield "a rig", ["status", "--rig", text]


def is_text(output: str) -> bool:
    """Return whether a terminal obeys nothing of an output, and no text of a stranger begins a line."""
    orders = re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200f\u202a-\u202e\u2028\u2029\u2066-\u2069]", output)
    return not orders and not re.search("^(b` c|telenano: fine)", output, re.MULTILINE)


def cases(folder: Path) -> Iterator[tuple[str, list[str]]]:
    for name, text in UGLY.items():
        own = folder / name.replace(" ", "_")
        own.mkdir()
        yield from ((f"{name}, {place}", line) for place, line in lines_of(own, text))
    half = folder / "half.yaml"
    for place, written in {"value": f"name: {HALF}", "key": f"{HALF}: 1", "list": f"a: [{HALF}]"}.items():
        path = half.with_name(f"half_{place}.yaml")
        path.write_text(written)
        for command in ("scenario check", "status --site-file", "experiment check", "up --scenario"):
            yield f"half of a character, {place}", [*command.split(), str(path)]


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    "count",
    [
        pytest.param(SHARE, marks=pytest.mark.check("tries a part of the texts, five seconds")),
        pytest.param(None, marks=pytest.mark.endurance("tries each text at each place, minutes")),
    ],
)
def test_an_ugly_text_is_shown_as_text(count: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "texts").mkdir()
    found = [case for case in cases(tmp_path / "texts") if not any("\0" in word for word in case[1])]
    assert len(found) > 350
    wrong = []
    for place, line in found if count is None else random.Random(SEED).sample(found, count):
        end = ended(line, MOST_S)
        if isinstance(end, str):
            wrong.append(f"{place}, {line}: goes on: {end[:600]}")
        elif end.raised:
            wrong.append(f"{place}, {line}: a traceback: {end.raised[-600:]}")
        elif not is_text(end.output):
            wrong.append(f"{place}, {line}: {end.output[-600:]!r}")
    assert not wrong, "\n".join(wrong)
