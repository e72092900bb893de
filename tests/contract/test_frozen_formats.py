"""Wire 1 and recording 1 stay what they are: what may be added is taken, and everything else is named."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from frozen_formats import FILE, Formats, broken, formats, main

FROZEN: Formats = json.loads(FILE.read_text(encoding="utf-8"))
LATER = "number, may be absent"


def changed(change: Callable[[Formats], object]) -> list[str]:
    """Return what is said of the frozen formats with a change."""
    now = copy.deepcopy(FROZEN)
    change(now)
    assert now != FROZEN
    return broken(FROZEN, now)


def fields(now: Formats, topic: str) -> dict[str, str]:
    found: dict[str, str] = now["wire"]["topics"][topic]["fields"]
    return found


def test_wire_1_and_recording_1_are_as_they_were_frozen() -> None:
    assert broken(FROZEN, formats()) == [], "put it back: proto/SPEC.md has the rules of change"


def test_what_was_added_is_in_the_file() -> None:
    assert formats() == FROZEN, "run python tests/contract/frozen_formats.py"


def _add_key(now: Formats) -> None:
    fields(now, "afm/state")["tip_temperature_k"] = LATER
    now["wire"]["topics"]["afm/state"]["version"] = 2


def _add_record(now: Formats) -> None:
    fields(now, "afm/state")["tip"] = "record Tip or null, may be absent"
    fields(now, "afm/state")["tip.radius_m"] = "number, required"
    now["wire"]["topics"]["afm/state"]["version"] = 2


ALLOWED: dict[str, Callable[[Formats], object]] = {
    "a key that may be absent": _add_key,
    "a key that readers may do without": lambda now: fields(now, "afm/state").update({"gain": LATER}),
    "a record that may be absent": _add_record,
    "a topic": lambda now: now["wire"]["topics"].update({"afm/wobble": now["wire"]["topics"]["afm/state"]}),
    "a publisher": lambda now: now["wire"]["topics"]["afm/state"]["published by"].append("afm_double"),
    "a channel": lambda now: now["recording"]["channels"].update({"afm/wobble": "AfmWobble"}),
    "an attachment": lambda now: now["recording"]["attachments"].update({"calibration.json": "application/json"}),
    "a metadata record": lambda now: now["recording"]["metadata"].update({"weather": ["room_k"]}),
    "a key of metadata": lambda now: now["recording"]["metadata"]["recording"].append("operator"),
    "a key of a channel's metadata": lambda now: now["recording"]["channel metadata"].append("unit"),
    "a record of the recorder": lambda now: now["recording"]["records"].update({"recorder/pause": {}}),
}


@pytest.mark.parametrize("name", ALLOWED)
def test_what_may_be_added_is_taken(name: str) -> None:
    assert changed(ALLOWED[name]) == []


def _set(path: str, value: object) -> Callable[[Formats], object]:
    def change(now: Formats) -> None:
        *parts, last = path.split(" > ")
        found: Any = now
        for part in parts:
            found = found[part]
        if value is None:
            del found[last]
        else:
            found[last] = value

    return change


STATE = "wire > topics > afm/state"
BREAKING = {
    "a field goes": (f"{STATE} > fields > deflection_m", None, "topic afm/state: field deflection_m is gone"),
    "a field in a record goes": (
        "wire > topics > node/health > fields > inputs[].lost",
        None,
        "topic node/health: field inputs[].lost is gone",
    ),
    "another type": (f"{STATE} > fields > limited", "string, required", "topic afm/state: field limited is `string"),
    "a narrower range": (
        f"{STATE} > fields > step_s",
        "number maximum 1.0 minimum 0.0, required",
        "topic afm/state: field step_s is `number maximum 1.0",
    ),
    "an optional field is required": (
        f"{STATE} > fields > device",
        'string enum ["ok", "stale", "lost"] or null, required',
        "topic afm/state: field device is `",
    ),
    "a required field may be absent": (
        f"{STATE} > fields > limited",
        "boolean, may be absent",
        "topic afm/state: field limited is `boolean, may be absent",
    ),
    "a word more": (
        f"{STATE} > fields > device",
        'string enum ["ok", "stale", "lost", "warm"] or null, may be absent',
        "topic afm/state: field device is `",
    ),
    "a required field is added": (
        f"{STATE} > fields > gain",
        "number, required",
        "topic afm/state: field gain is new and `number, required`: what is added may be absent",
    ),
    "a version without a field": (f"{STATE} > version", 2, "topic afm/state: version 2, and 1 is frozen"),
    "a version goes back": (f"{STATE} > version", 0, "topic afm/state: version 0, and 1 is frozen"),
    "a topic goes": (STATE, None, "topic afm/state is gone"),
    "another delivery": (f"{STATE} > delivery", "lossless", "topic afm/state: delivery is lossless"),
    "another way over the link": (f"{STATE} > over the link", "backward", "topic afm/state: over the link is backward"),
    "a publisher goes": (f"{STATE} > published by", ["b"], "topic afm/state: afm_node publishes it no longer"),
    "another wire": ("wire > version", "2", "the wire is 2, and 1 is frozen"),
    "another format": ("recording > format", "2", "format of recordings is 2, and 1 is frozen"),
    "another profile": ("recording > profile", "x", "profile of recordings is x"),
    "another encoding": ("recording > message encodings", ["cbor"], "message encodings of recordings are cbor"),
    "a channel goes": (
        "recording > channels > teleop/forward@slave",
        None,
        "channels of recordings: teleop/forward@slave is gone",
    ),
    "another schema": ("recording > channels > afm/state", "Afm", "channels of recordings: afm/state is Afm"),
    "channel metadata goes": ("recording > channel metadata", ["topic"], "channels of recordings have no src"),
    "an attachment goes": (
        "recording > attachments > scenario.yaml",
        None,
        "attachments of recordings: scenario.yaml is gone",
    ),
    "metadata goes": ("recording > metadata > end", None, "metadata record end of recordings has no state"),
    "a record goes": ("recording > records > recorder/gap", None, "records recorder/gap of recordings are gone"),
    "a record has a field more": (
        "recording > records > recorder/gap > why",
        "string, required",
        "record recorder/gap: field why is new",
    ),
}


@pytest.mark.parametrize("name", BREAKING)
def test_what_breaks_a_format_is_named(name: str) -> None:
    path, value, said = BREAKING[name]
    assert any(text.startswith(said) for text in changed(_set(path, value))), changed(_set(path, value))


def test_each_field_that_goes_or_is_another_is_found() -> None:
    for topic, row in FROZEN["wire"]["topics"].items():
        frozen: Formats = {"wire": {"version": "1", "topics": {topic: row}}, "recording": FROZEN["recording"]}
        for field, text in row["fields"].items():
            others = {path: other for path, other in row["fields"].items() if path != field}
            for changed_fields, said in (
                (others, "is gone"),
                (others | {field: f"not {text}"}, f"is `not {text}`, and `{text}` is frozen"),
            ):
                topics = {topic: row | {"fields": changed_fields}}
                now: Formats = {"wire": {"version": "1", "topics": topics}, "recording": FROZEN["recording"]}
                assert broken(frozen, now) == [f"topic {topic}: field {field} {said}"]


def test_the_file_is_written_anew_only_where_nothing_is_broken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "frozen.json"
    older = copy.deepcopy(FROZEN)
    del older["wire"]["topics"]["afm/program"]
    file.write_text(json.dumps(older))
    assert main(file) == 0
    assert file.read_text(encoding="utf-8") == FILE.read_text(encoding="utf-8")
    fields(older, "afm/state")["gone_m"] = "number, required"
    kept = json.dumps(older)
    file.write_text(kept)
    assert main(file) == 1
    assert capsys.readouterr().err == "topic afm/state: field gone_m is gone\n"
    assert file.read_text() == kept
