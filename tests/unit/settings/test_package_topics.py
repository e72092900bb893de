"""Topics of packages: declared as those of the core, imported when they are named, and kept without the package."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

import pytest
from mcap.reader import make_reader
from msgspec import Meta

from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.verify import verify
from telenano.recording.writer import RecordingWriter
from telenano.testing import install_package, run_with
from telenano.wire import TOPICS, DurationS, Message, Topic, about, decode, encode
from telenano.wire.topics import MOST_UNKNOWN, keep_unknown, register_topic, row_of

MESSAGES = '''
from typing import Annotated

from telenano.wire import Message, Range, Topic, about

SPEED = Range("wind", 0.0, 200.0, "m/s", "twice the fastest gust that was measured")


class WindSpeed(Message):
    """The draught at the instrument."""

    speed_m_per_s: Annotated[float, SPEED.of_value(), about("Speed of the air [m/s]")]


WIND_SPEED = Topic("wind/speed", WindSpeed, ("experiment",), "lossless", None, None, None)
'''
ENTRIES = {"topics": {"wind_speed": "wind.messages:WIND_SPEED"}}
RECORD = """
import json, sys
from pathlib import Path
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.publisher import NullPublisher
from telenano.timing.clock import SystemClock
from telenano.wire import TOPICS, encode
from telenano.wire.codec import accept
from telenano.settings.package_topics import installed_topics

found = {"named": installed_topics(), "before": [name for name in sys.modules if name.startswith("wind")]}
publisher, limited, sent = NullPublisher(SystemClock(), "experiment@master"), [], []
publisher.on_limited = limited.append
publisher.send = lambda topic, payload: sent.append(payload)
for speed in (3.5, 1e3):
    publisher.publish("wind/speed", speed_m_per_s=speed)
found["after"] = sorted(name for name in sys.modules if name.startswith("wind"))
found["limited"] = limited
found["speeds"] = [accept("wind/speed", payload).speed_m_per_s for payload in sent]
writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=Path(sys.argv[1])))
channel = writer.channel("wind/speed", "experiment@master", "master")
for number, payload in enumerate(sent):
    t_ns = accept("wind/speed", payload).t_ns
    writer.write(channel, t_ns, t_ns, number, payload)
writer.finish({"state": "stopped", "note": ""})
print(json.dumps(found))
"""
READ = """
import json, sys
from typer.testing import CliRunner
from telenano.cli.root import app
told = {}
for line in json.loads(sys.argv[1]):
    done = CliRunner().invoke(app, line.split())
    told[line] = [done.exit_code, done.stdout, done.stderr]
print(json.dumps(told))
"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    install_package(tmp_path / "site", "wind", {"__init__.py": "", "messages.py": MESSAGES}, ENTRIES)
    return tmp_path / "site"


@pytest.mark.check("takes 1.6 s")
def test_a_topic_of_a_package_is_sent_limited_read_and_recorded_with_its_schema(site: Path, tmp_path: Path) -> None:
    found = json.loads(run_with(RECORD, site, str(tmp_path / "recorded")))
    assert "wind/speed" in found["named"] and found["before"] == [] and found["after"] == ["wind", "wind.messages"]
    assert found["speeds"] == [3.5, 200.0]
    assert found["limited"] == ["WindSpeed: speed_m_per_s = 1000.0 is out of range and is sent at the end of the range"]

    # This process has no such package.
    recording = Recording(tmp_path / "recorded" / "session.mcap")
    (channel,) = recording.channels
    assert (channel.topic, channel.src) == ("wind/speed", "experiment@master")
    assert [message.fields()["speed_m_per_s"] for message in recording.messages()] == [3.5, 200.0]
    with (tmp_path / "recorded" / "session.mcap").open("rb") as file:
        schema, _, _ = next(make_reader(file).iter_messages())
    assert schema is not None and schema.name == "WindSpeed" and b'"maximum": 200.0' in schema.data
    verdict = verify([recording.path])
    assert verdict.sound
    (said,) = [finding.text for finding in verdict.findings if finding.channel == "wind/speed"]
    assert said.startswith("2 messages of a topic that no installed package declares")


@pytest.mark.check("takes 3.2 s")
def test_commands_read_a_recording_with_and_without_the_package(site: Path, tmp_path: Path) -> None:
    run_with(RECORD, site, str(tmp_path / "recorded"))
    file = tmp_path / "recorded" / "session.mcap"
    lines = [f"bag info {file}", f"bag verify {file}", f"bag export {file} --to mcap-json --out {tmp_path}/OUT.mcap"]
    for without in ("", "1"):
        asked = [line.replace("OUT", f"out{without}") for line in lines]
        told = json.loads(run_with(READ, site, json.dumps(asked), TELENANO_WITHOUT_PACKAGES=without))
        assert [code for code, _, _ in told.values()] == [0, 0, 0], told
        assert "wind/speed" in told[asked[0]][1]
        assert ("no installed package declares" in told[asked[1]][1]) == bool(without)
        with (tmp_path / f"out{without}.mcap").open("rb") as copy:
            messages = [
                (channel.topic, json.loads(message.data)) for _, channel, message in make_reader(copy).iter_messages()
            ]
        speeds = [fields["speed_m_per_s"] for topic, fields in messages if "wind/speed" in topic]
        assert speeds == [3.5, 200.0]


def test_the_recorder_keeps_what_it_does_not_know_and_counts_it(tmp_path: Path) -> None:
    assert keep_unknown("rain/fall") is not None
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=tmp_path))
    channel = writer.channel("rain/fall", "experiment@master", "master")
    payload = b"\x85\xa3seq\x00\xa4t_ns\x01\xa3src\xb1experiment@master\xa1v\x01\xa2mm\x07"
    writer.write(channel, 1, 1, 0, payload)
    writer.finish()
    (message,) = Recording(writer.path).messages()
    assert message.payload == payload and message.fields()["mm"] == 7
    assert type(decode("rain/fall", payload)) is Message


def test_names_that_are_kept_are_well_formed_new_and_few() -> None:
    for name in ("rain", "rain/", "Rain/fall", "rain/fall/slow", "haptic/statex", "haptic/stat", "haptic/state", ""):
        assert keep_unknown(name) is None, name
    letters = "abcdefghijklmnopqrstuvwxyz"
    kept = [keep_unknown(f"rain/{first}{second}") for first in letters for second in letters]
    assert sum(row is not None for row in kept) == MOST_UNKNOWN
    assert row_of("rain/zz") is None


class Gust(Message):
    """A gust."""

    duration_s: Annotated[DurationS, about("How long it lasts [s]")]


class NoBounds(Message):
    """A number of any size."""

    duration_s: Annotated[float, about("How long it lasts [s]")]


class NoDescription(Message):
    """A number that is not described."""

    duration_s: DurationS


class CountOfAnySize(Message):
    """A count without an end."""

    gusts: Annotated[int, Meta(ge=0), about("Gusts")]


class AfmState(Message):
    """A message with the name of another one."""

    duration_s: Annotated[DurationS, about("How long it lasts [s]")]


GOOD = Topic("wind/gust", Gust, ("experiment",), "lossless", None, None, None)
FAULTS: list[tuple[dict[str, Any], str]] = [
    ({"name": "wind"}, "must be two words of lower-case letters with / between them"),
    ({"name": "haptic/state"}, "telenano has the topic haptic/state"),
    ({"name": "haptic/statex"}, "telenano has the topic haptic/state"),
    ({"model": Message}, "must be a class that inherits from telenano.wire.Message"),
    ({"model": dict}, "must be a class that inherits from telenano.wire.Message"),
    ({"model": AfmState}, "AfmState is the name of another message"),
    ({"publishers": ()}, "publishers: none: must be among"),
    ({"publishers": ("weather",)}, "publishers: weather: must be among"),
    ({"publishers": ("*",)}, r"publishers: \*: must be among"),
    ({"bridged": "forward"}, "the link carries the topics of telenano only"),
    ({"delivery": "latest"}, "needs rate_hz and deadline_s"),
    ({"rate_hz": 10.0, "deadline_s": 1.0}, "lossless has neither rate_hz nor deadline_s"),
    ({"delivery": "latest", "rate_hz": 10.0, "deadline_s": 0.1}, "deadline_s must be 3 to 100 periods"),
    ({"model": NoBounds}, "NoBounds.duration_s is a number without bounds"),
    ({"model": CountOfAnySize}, "CountOfAnySize.gusts is a number without bounds"),
    ({"model": NoDescription}, "NoDescription.duration_s has no description"),
]


@pytest.mark.parametrize(("change", "said"), FAULTS, ids=[said[:40] for _, said in FAULTS])
def test_a_row_that_breaks_a_rule_is_refused_in_a_sentence(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        register_topic(dataclasses.replace(GOOD, **change))
    assert "wind/gust" not in TOPICS


def test_a_row_that_keeps_the_rules_has_its_messages_encoded_and_decoded() -> None:
    assert register_topic(GOOD) is register_topic(GOOD) is row_of("wind/gust")
    message = Gust(seq=1, t_ns=2, src="experiment@master", v=1, duration_s=0.5)
    assert decode("wind/gust", encode(message)) == message


@pytest.mark.check("takes 3.1 s")
def test_an_entry_that_is_no_such_topic_is_told_of_where_it_is_named(site: Path, tmp_path: Path) -> None:
    for kind, target, said in (
        ("other", "wind.messages:WIND_SPEED", "declares wind/speed, whose entry must be called wind_speed"),
        ("speed", "wind.messages:SPEED", "is a Range, must be a Topic of telenano.wire"),
    ):
        folder = tmp_path / kind
        install_package(
            folder, "wind", {"__init__.py": "", "messages.py": MESSAGES}, {"topics": {f"wind_{kind}": target}}
        )
        lines = [f"topic info wind/{kind}"]
        told = json.loads(run_with(READ, folder, json.dumps(lines)))
        code, _, err = told[lines[0]]
        assert code == 2 and said in err, told
