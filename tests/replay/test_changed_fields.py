"""What `verify` calls sound has a report, whatever its fields are: absent, nil, the least or the greatest."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
from changed_fields import Case, cases_of, is_valid, with_examples, write_changed

from services.viz_node.feed import Feed, SeenMessage
from telenano.analysis import Session, summary_of
from telenano.analysis.recording_document import judged_recording
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.recording.verify import verify
from telenano.testing import run
from telenano.virtual import NODES, record_session
from telenano.wire.errors import RecordingError

# The share of its longer tests that is in `make check` where the change touches none of these folders.
pytestmark = pytest.mark.drawn(0.5, "telenano/recording/", "telenano/wire/", "telenano/rerun/", "telenano/analysis/")

# so many messages of a recording are changed at once
AT_ONCE = 25


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session of all nodes, with a message of each topic."""
    folder = tmp_path_factory.mktemp("source")
    path = record_session(folder, 3, ("realtime.rate_hz=250", "controller.law=wave"), 1.6)
    return with_examples(path, folder / "source.mcap")


@pytest.fixture(scope="module")
def valid(source: Path) -> list[Case]:
    """Return the changes after which the recording is sound, each of another message within AT_ONCE."""
    cases = cases_of(source, 7)
    found = [case for case, is_sound in zip(cases, is_valid(source, cases), strict=True) if is_sound]
    assert len(found) > 1000
    return found


def batch(cases: list[Case], number: int) -> list[Case]:
    own = cases[number * AT_ONCE : (number + 1) * AT_ONCE]
    return list({case.place: case for case in own}.values())


def strict(document: Any) -> str:
    """Return JSON that any reader takes."""
    text = json.dumps(document, allow_nan=False)
    json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    return text


def check(source: Path, cases: list[Case], target: Path) -> Path:
    """Each of the changes is one of a sound recording, and all that reads it has something to say of it."""
    names = [case.name for case in cases]
    path = write_changed(source, target, cases)
    verdict = verify([path])
    recording = open_recordings([path])
    try:
        summary = summary_of(Session.of(recording), recording)
        document = judged_recording(open_recordings([path]))
    except RecordingError as error:
        # the header of a message is its place in the file
        assert not verdict.sound, (names, error)
        return path
    strict(summary)
    strict(document)
    msgpack.packb(document)
    # the last word of the hand may be what was changed: then both say that its force profile is cut
    assert summary["recording"]["complete"] is verdict.sound, (names, summary["recording"]["missing"], verdict.findings)
    assert "fault" not in document, names
    feed = Feed()
    for message in recording.messages():
        try:
            fields = message.checked_fields()
        except (RecordingError, KeyError):
            continue
        feed.record(SeenMessage(message.topic, message.src, message.publish_ns, fields))
    msgpack.packb(feed.take())
    msgpack.packb(feed.snapshot())
    # a time that no page can draw is left out, and so is nothing else; a clock of the link counts until its next report
    of_clock = sum(AT_ONCE * 10 for case in cases if case.path[0] == "clock")
    assert set(feed.left_out.rejected) <= {"unreadable"}
    assert feed.left_out.rejected.get("unreadable", 0) <= len(cases) + of_clock, (names, feed.left_out.last_error)
    return path


@pytest.mark.check("reads recordings")
@pytest.mark.parametrize("number", range(5))
def test_what_verify_calls_sound_has_a_report(number: int, source: Path, valid: list[Case], tmp_path: Path) -> None:
    check(source, batch(valid, number), tmp_path / "changed.mcap")


@pytest.mark.endurance
@pytest.mark.parametrize("number", range(5, 80))
def test_every_field_of_every_message_has_a_report(
    number: int, source: Path, valid: list[Case], tmp_path: Path
) -> None:
    if cases := batch(valid, number):
        check(source, cases, tmp_path / "changed.mcap")


# what makes no sound recording of it, but a reader meets all the same
@pytest.mark.endurance
@pytest.mark.parametrize("number", range(20))
def test_what_is_no_message_ends_no_reader(number: int, source: Path, tmp_path: Path) -> None:
    cases = cases_of(source, 8)
    odd = [case for case, is_sound in zip(cases, is_valid(source, cases), strict=True) if not is_sound]
    path = write_changed(source, tmp_path / "changed.mcap", batch(odd, number))
    assert not verify([path]).sound
    recording = open_recordings([path])
    strict(summary_of(Session.of(recording), recording))


FORMATS = ("csv", "mcap-json", "parquet", "hdf5")
COMMANDS: dict[str, Callable[[Path, Path], tuple[object, ...]]] = {
    "report": lambda file, out: ("report", file, "--out", out),
    "info": lambda file, out: ("bag", "info", file, "--json"),
    "cat": lambda file, out: ("bag", "cat", file),
    "filter": lambda file, out: ("bag", "filter", file, "--out", out.with_suffix(".mcap")),
    "split": lambda file, out: ("bag", "split", file, "--out", out, "--interval", "0.5"),
    "merge": lambda file, out: ("bag", "merge", file, "--out", out.with_suffix(".mcap")),
    "recover": lambda file, out: ("bag", "recover", file, "--out", out.with_suffix(".mcap")),
    "diff": lambda file, out: ("bag", "diff", file, file),
    **{kind: lambda file, out, kind=kind: ("bag", "export", file, "--to", kind, "--out", out) for kind in FORMATS},
}


@pytest.mark.check("runs every command of recordings")
def test_every_command_takes_a_changed_recording(source: Path, valid: list[Case], tmp_path: Path) -> None:
    cases = [case for case in batch(valid, 90) or batch(valid, 9) if not case.topic.startswith("session/event")]
    path = write_changed(source, tmp_path / "changed.mcap", cases)
    names = [case.name for case in cases]
    for name, command in COMMANDS.items():
        code, out, err = run(*command(path, tmp_path / name.replace("-", "_")))
        assert code == 0, (name, names, out[-500:], err)
        if name in ("info", "cat"):
            for line in out.splitlines():
                strict(json.loads(line, parse_constant=lambda word: pytest.fail(f"{word} is not JSON")))
    for case in cases:
        field = f"{case.topic}.{'.'.join(map(str, case.path))}"
        code, _, err = run("bag", "plot", path, field, "--out", tmp_path / "plot.png")
        # text, and what has parts, cannot be drawn
        assert code == 0 or "is text" in err or "name one of its parts" in err or "has no field" in err, (
            case.name,
            err,
        )
    for node in NODES:
        code, _, err = run("bag", "rerun", path, "--node", node)
        # the node was given something else than it recorded
        assert code in (0, 1), (node, names, err)


@pytest.mark.check("runs a command of recordings")
@pytest.mark.parametrize("topic", ["afm/state", "haptic/state"])
@pytest.mark.parametrize("key", ["placed", "armed"])
@pytest.mark.parametrize("word", ["absent", "nil"])
def test_a_yes_or_no_that_one_message_lacks_is_no_number_there(
    topic: str, key: str, word: str, source: Path, tmp_path: Path
) -> None:
    places = [place for place, one in enumerate(Recording(source).raw()) if one.channel.channel_topic == topic]
    if topic == "haptic/state" and key == "placed":
        pytest.skip("the hand has no such key")
    (case,) = [one for one in cases_of(source, 1) if (one.topic, one.path, one.word) == (topic, (key,), word)][:1]
    path = write_changed(source, tmp_path / "changed.mcap", [case._replace(place=places[200])])
    assert verify([path]).sound
    values = Recording(path).columns(topic, (key,))[key]
    assert values.dtype.kind == "f"
    assert (values != values).sum() == 1
    assert run("report", path, "--out", tmp_path / "out")[0] == 0
    assert run("bag", "plot", path, f"{topic}.{key}", "--out", tmp_path / "plot.png")[0] == 0
