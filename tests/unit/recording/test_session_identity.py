"""Which files are read as one session: the table of docs/recording.md, over each command that reads several."""

import socket
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer
import zmq
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, session_control
from telenano_lab.studies.compare_command import compare
from typer.testing import CliRunner

import telenano
from services.player.command import replay
from services.recorder.intake import Intake, Listener, begin_recording
from services.viz_node.command import view
from telenano.cli.commands.bag import app as bag
from telenano.cli.commands.report import report
from telenano.recording.channel_filter import Selection
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.rewrite import CopyWriter, filter_recording, merge_recordings, split_recording
from telenano.recording.session_identity import SESSION_NAME, SESSION_VARIABLE, SessionIdentity, given_identity
from telenano.runtime.bus.bus import Subscriber
from telenano.testing import VirtualClock
from telenano.wire import encode
from telenano.wire.errors import RecordingError

# The share of its cases in `make check` where the change touches none of these: all commands decide by one function.
pytestmark = pytest.mark.drawn(0.3, "telenano/recording/", "telenano/analysis/", "telenano/cli/")

Said = dict[str, str]
OF_LAUNCHER: Said = {"rig": "1", "began_ns": str(EPOCH_NS), "session": "1-100-aa", "starts": "s1"}
OF_FAR_SITE: Said = {"rig": "1", "began_ns": str(EPOCH_NS + 1), "run": "1-90-bb", "starts": "s0 s1"}
LATER: Said = {**OF_LAUNCHER, "session": "1-200-cc", "starts": "s2"}
OF_RECORDER: Said = {"rig": "", "began_ns": str(EPOCH_NS), "run": "recorder-1", "starts": "s1"}


class Case(NamedTuple):
    """What files say, the site of each, and what becomes of them without and with --same-session.

    A result is the number of files that are read, or a part of the sentence of the refusal.
    """

    said: tuple[Said | None, ...]
    sites: tuple[str, ...]
    plain: int | str
    insisted: int | str


TWO, UNKNOWN = "are of two sessions", "--same-session"
CASES = {
    "one file twice": Case((OF_LAUNCHER, OF_LAUNCHER), ("copy", "copy"), 1, 1),
    "one old file twice": Case((None, None), ("copy", "copy"), 1, 1),
    "parts of one recording": Case((OF_LAUNCHER, OF_LAUNCHER), ("early", "late"), 2, 2),
    "parts of a recorder alone, one without a start": Case(
        (OF_RECORDER, {**OF_RECORDER, "starts": ""}), ("early", "late"), 2, 2
    ),
    "two sites": Case((OF_LAUNCHER, OF_FAR_SITE), ("master", "slave"), 2, 2),
    "after a restart of the recorder": Case((OF_LAUNCHER, {**OF_LAUNCHER, "starts": ""}), ("early", "late"), 2, 2),
    "the far site before and after a restart": Case(
        (OF_LAUNCHER, OF_FAR_SITE, {**OF_FAR_SITE, "starts": ""}), ("master", "slave early", "slave late"), 3, 3
    ),
    "the far site after a restart alone": Case(
        (OF_LAUNCHER, {**OF_FAR_SITE, "starts": ""}), ("master", "slave"), UNKNOWN, 2
    ),
    "an extract and its whole": Case((OF_LAUNCHER, OF_LAUNCHER), ("early", "whole"), "same messages", "same messages"),
    "two sessions of one rig": Case((OF_LAUNCHER, LATER), ("early", "late"), TWO, TWO),
    "two sessions with one recording of the far site": Case(
        (OF_LAUNCHER, OF_FAR_SITE, {**LATER, "starts": "s0"}), ("early", "slave", "late"), TWO, TWO
    ),
    "two sessions of one recorder": Case((OF_RECORDER, {**OF_RECORDER, "starts": "s9"}), ("early", "late"), TWO, TWO),
    "sessions of two rigs": Case(
        (OF_LAUNCHER, {**LATER, "rig": "other", "session": "other-1-dd"}), ("early", "late"), TWO, TWO
    ),
    "two recorders without a start": Case(
        ({**OF_RECORDER, "starts": ""}, {**OF_RECORDER, "run": "recorder-2", "starts": ""}),
        ("early", "late"),
        UNKNOWN,
        2,
    ),
    "one with and one without": Case((OF_LAUNCHER, None), ("early", "late"), UNKNOWN, 2),
    "two without": Case((None, None), ("early", "late"), UNKNOWN, 2),
}
# What of the session each file has [s], and of which channels.
PORTIONS: Mapping[str, tuple[float, float | None, Callable[[str], bool]]] = {
    "copy": (0.0, None, lambda topic: True),
    "whole": (0.0, None, lambda topic: True),
    "early": (0.0, 1.0, lambda topic: True),
    "late": (1.0, None, lambda topic: True),
    "master": (0.0, None, lambda topic: not topic.startswith("afm/")),
    "slave": (0.0, None, lambda topic: topic.startswith("afm/")),
    "slave early": (0.0, 1.0, lambda topic: topic.startswith("afm/")),
    "slave late": (1.0, None, lambda topic: topic.startswith("afm/")),
}


# What was written once is not written again.
_LABELLED: dict[tuple[Path, str, str], bytes] = {}


def labelled(source: Path, target: Path, said: Said | None, portion: str) -> Path:
    """Write a portion of a session as if a recorder that says this of it had recorded it."""
    start_s, end_s, wanted = PORTIONS[portion]
    target.parent.mkdir(parents=True, exist_ok=True)
    if (known := _LABELLED.get((source, repr(said), portion))) is not None:
        target.write_bytes(known)
        return target
    recording = Recording(source)
    begin_ns = recording.span_ns[0] + round(start_s * 1e9)
    after_ns = None if end_s is None else recording.span_ns[0] + round(end_s * 1e9)
    with CopyWriter(target) as writer:
        for name, record in recording.attachment_records.items():
            writer.attach(name, record.media_type, record.data, record.log_time)
        site = "slave" if portion.startswith("slave") else "master"
        writer.add_metadata("recording", {**recording.metadata["recording"], "node": f"recorder@{site}"})
        if said is not None:
            writer.add_metadata(SESSION_NAME, said)
        for message in recording.raw():
            within = message.log_ns >= begin_ns and (after_ns is None or message.log_ns < after_ns)
            if within and wanted(message.channel.topic):
                writer.add(message)
    _LABELLED[source, repr(said), portion] = target.read_bytes()
    return target


commands = typer.Typer()
commands.add_typer(bag, name="bag")
for function in (report, replay, view, compare):
    commands.command()(function)


class Read(NamedTuple):
    """What came of a command: its exit code and what it printed, on one line."""

    code: int
    text: str

    @classmethod
    def by(cls, *arguments: str | Path) -> "Read":
        done = CliRunner().invoke(commands, [str(argument) for argument in arguments])
        return cls(done.exit_code, " ".join(f"{done.output} {done.exception or ''}".split()))


def opened(files: list[Path], options: list[str], folder: Path) -> Read:
    try:
        messages = telenano.open(*files, same_session=bool(options))._source.info().messages
    except RecordingError as error:
        return Read(1, str(error))
    return Read(0, f'"messages": {messages},')


def merged(files: list[Path], options: list[str], folder: Path) -> Read:
    return Read.by("bag", "merge", *files, *options, "--out", folder / "merged.mcap", "--json")


def verified(files: list[Path], options: list[str], folder: Path) -> Read:
    # A portion lacks what is elsewhere, which is not what is asked here.
    return Read.by("bag", "verify", *files, *options, "--json")


def printed(files: list[Path], options: list[str], folder: Path) -> Read:
    done = CliRunner().invoke(commands, ["bag", "cat", *map(str, files), *options])
    return Read(done.exit_code, f'"messages": {len(done.stdout.splitlines())},' if not done.exit_code else done.output)


def reported(files: list[Path], options: list[str], folder: Path) -> Read:
    return Read.by("report", *files, *options, "--out", folder / "report", "--json")


def played(files: list[Path], options: list[str], folder: Path) -> Read:
    # A rig without a player is refused when the files are read.
    site_file = folder / "site.yaml"
    site_file.write_text("nodes: {}\n")
    return Read.by("replay", *files, *options, "--site-file", site_file)


def shown(files: list[Path], options: list[str], folder: Path) -> Read:
    # A port that another process has is refused when the files are read.
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        code, text = Read.by("view", *files, *options, "--port", port)
    return Read(code, text.replace(port, "PORT"))


def compared(files: list[Path], options: list[str], folder: Path) -> Read:
    of_one = folder / "of one"
    of_one.mkdir()
    for number, file in enumerate(files):
        (of_one / f"session_{number}.mcap").write_bytes(file.read_bytes())
    other = labelled(
        folder / "source.mcap", folder / "other.mcap", {**LATER, "session": "9-9-9", "starts": ""}, "whole"
    )
    return Read.by("compare", of_one, other, *options, "--out", folder / "compare", "--json")


# Each with what it prints where the files were read as one: the messages in them, or what is refused next.
CONSUMERS: Mapping[str, tuple[Callable[[list[Path], list[str], Path], Read], str]] = {
    "open": (opened, '"messages": {messages},'),
    "merge": (merged, '"messages": {messages},'),
    "verify": (verified, '"messages": {messages},'),
    "cat": (printed, '"messages": {messages},'),
    "report": (reported, '"messages": {messages}'),
    "replay": (played, "site.yaml"),
    "view": (shown, "PORT"),
    "compare": (compared, '"session": "of one"'),
}


@pytest.fixture(scope="module")
def source(recording_of: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    short = tmp_path_factory.mktemp("short") / "source.mcap"
    chosen = Selection.of(("haptic/*", "afm/state", "node/health", "session/*"))
    filter_recording(recording_of("wave"), short, chosen, end_s=1.6)
    return short


# What draws takes seconds for each, and decides by the same function as the others: these cases are joined in a check.
DRAWN = ("parts of one recording", "two sites", "two without")


def table() -> Iterator[Any]:
    """Yield each case with each consumer; where a figure is drawn of all others on demand."""
    for case, (_, _, plain, insisted) in CASES.items():
        for consumer in CONSUMERS:
            draws = consumer in ("report", "compare") and not (isinstance(plain, str) and isinstance(insisted, str))
            mark = (
                pytest.mark.endurance("takes 1 min") if draws and case not in DRAWN else pytest.mark.check("takes 15 s")
            )
            yield pytest.param(case, consumer, marks=mark)


@pytest.mark.parametrize(("case", "consumer"), tuple(table()))
def test_each_command_reads_the_files_of_one_session_and_refuses_others(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str, consumer: str
) -> None:
    # The page is served where its files were built, which nobody asks for here.
    monkeypatch.setattr("services.viz_node.command.missing_for_view", lambda: "")
    said, portions, plain, insisted = CASES[case]
    read, sign = CONSUMERS[consumer]
    draws = consumer in ("report", "compare")
    for options, expected in (([], plain), (["--same-session"], insisted)):
        if draws and options and plain == insisted:
            continue
        folder = tmp_path / ("insisted" if options else "plain")
        folder.mkdir()
        (folder / "source.mcap").write_bytes(source.read_bytes())
        files = [
            labelled(source, folder / f"{number}.mcap", words, portion)
            for number, (words, portion) in enumerate(zip(said, portions, strict=True))
        ]
        found = read(files, options, folder)
        if isinstance(expected, str):
            assert found.code != 0, found
            assert expected in found.text, found
            # Two files are named, and the way that leads on.
            assert sum(file.name in found.text or f"session_{n}" in found.text for n, file in enumerate(files)) >= 2
            assert expected == "same messages" or "telenano compare" in found.text
        else:
            messages = sum(Recording(file).info().messages for file in files[:expected])
            assert sign.format(messages=messages) in found.text, (found, messages)
            assert TWO not in found.text
            assert "same messages" not in found.text


@pytest.mark.check("takes 3 s")
def test_sessions_that_are_compared_count_once_and_not_as_two_of_their_files(source: Path, tmp_path: Path) -> None:
    one = labelled(source, tmp_path / "one.mcap", OF_LAUNCHER, "whole")
    same = labelled(source, tmp_path / "same.mcap", OF_LAUNCHER, "whole")
    other = labelled(source, tmp_path / "other.mcap", LATER, "whole")
    site = labelled(source, tmp_path / "site.mcap", OF_FAR_SITE, "whole")
    found = Read.by("compare", one, same, other, "--out", tmp_path / "out", "--json")
    assert found.text.count('"session":') == 2, found
    found = Read.by("compare", one, site, "--out", tmp_path / "out", "--json")
    assert found.code != 0
    assert "are of one session" in found.text


def test_a_recording_that_is_made_from_others_keeps_what_they_say(source: Path, tmp_path: Path) -> None:
    master = labelled(source, tmp_path / "session.mcap", OF_LAUNCHER, "master")
    (tmp_path / "far").mkdir()
    slave = labelled(source, tmp_path / "far" / "session.mcap", OF_FAR_SITE, "slave early")
    again = labelled(source, tmp_path / "far" / "again" / "session.mcap", {**OF_FAR_SITE, "starts": ""}, "slave late")
    merged_file, filtered = tmp_path / "both.mcap", tmp_path / "filtered.mcap"
    merge_recordings([master, slave, again], merged_file)
    filter_recording(merged_file, filtered, start_s=0.5)
    parts = split_recording(filtered, tmp_path / "parts", interval_s=0.5)
    for path in (merged_file, filtered, *(Path(part.path) for part in parts)):
        said = SessionIdentity.of(Recording(path).metadata)
        assert (said.sessions, said.starts, said.runs) == ({"1-100-aa"}, {"s0", "s1"}, {"1-90-bb"})


class Recorder:
    """A recorder without a bus, which writes to files of its own."""

    def __init__(self, folder: Path, context: "zmq.Context[Any]", begin_ns: int, **settings: Any) -> None:
        self.folder, self.clock = folder, VirtualClock(begin_ns, EPOCH_NS)
        folder.mkdir(exist_ok=True)
        (folder / "site.yaml").write_text("nodes: {}\n")
        config = RecorderConfig(directory=folder, **settings)
        self.intake: Intake = begin_recording(NODE, self.clock, config, folder / "site.yaml", None)
        subscriber = Subscriber(context, self.clock, {"inproc://nowhere": ["haptic/state"]})
        self.listener = Listener("haptic_node@master", subscriber)
        self._seq = 0

    def receive(self, *starts: str) -> None:
        """Receive some messages of the hand, and the commands with these ids before them."""
        import msgspec

        rows: list[Any] = [
            ("session/control", msgspec.structs.replace(session_control(0), command="start", id=start))
            for start in starts
        ]
        rows += [("haptic/state", haptic_state(self._seq + number)) for number in range(5)]
        self._seq += 5
        for topic, message in rows:
            self.clock.advance_ns(MILLISECOND_NS)
            self.intake.record(self.listener, [topic.encode(), encode(message)], self.clock.now_ns())

    def end(self) -> None:
        self.intake.finish()
        self.listener.subscriber.close()

    def said(self) -> list[SessionIdentity]:
        files = sorted(self.folder.glob("*.mcap"), key=lambda path: (len(path.name), path.name))
        return [SessionIdentity.of(Recording(file).metadata) for file in files]


def test_a_recorder_says_whose_session_its_files_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of_launcher = given_identity("lab", EPOCH_NS, conducts=True)
    of_site = given_identity("lab", EPOCH_NS, conducts=False)
    with zmq.Context() as context:
        monkeypatch.setenv(SESSION_VARIABLE, of_launcher)
        # The second file begins after a second, within the session.
        recorder = Recorder(tmp_path / "rig", context, 0, split_interval_s=1.0)
        recorder.receive("s1")
        recorder.clock.advance_ns(10**9)
        recorder.intake.flush(recorder.clock.monotonic_ns())
        recorder.receive()
        again = Recorder(tmp_path / "rig again", context, 10**9)
        again.receive()
        monkeypatch.setenv(SESSION_VARIABLE, of_site)
        site = Recorder(tmp_path / "site", context, 0)
        site.receive("s1")
        # A recorder that nobody started, which is commanded to a file of its own for each session.
        monkeypatch.delenv(SESSION_VARIABLE)
        alone = Recorder(tmp_path / "alone", context, 0)
        for start in ("s1", "s2"):
            alone.intake.split(alone.clock.monotonic_ns())
            alone.receive(start)
        for each in (recorder, again, site, alone):
            each.end()
    first, second = recorder.said()
    (restarted,), (far,) = again.said(), site.said()
    idle, one, other = alone.said()
    assert first.starts == second.starts == far.starts == {"s1"}
    assert first.is_that_of(second)
    assert first.is_that_of(restarted)
    assert second.is_that_of(far)
    assert restarted.is_that_of(far) is None
    assert one.is_that_of(first)
    assert one.is_that_of(other) is False
    assert other.is_that_of(first) is False
    assert (idle.starts, idle.runs) == (set(), one.runs)
