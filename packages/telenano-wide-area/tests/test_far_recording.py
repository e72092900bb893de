"""The recording of the other site: what it sends is checked, a fetch goes on where it ended, and a lie is refused."""

import asyncio
import contextlib
import hashlib
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from telenano_wide_area import far_recording
from telenano_wide_area.far_recording import PartialFile, fetch
from telenano_wide_area.piece_sender import BYTES, FILE, HEAD_BYTES, MOST_BYTES, OFFSET, PIECE_BYTES, RATE, PieceSender
from telenano_wide_area.relay.server import Relay
from telenano_wide_area.relay.site_end import SiteEnd

from telenano.recording import FileSettings, RecordingWriter
from telenano.runtime import AccessControl, AddressBook, Keyring, StructuredLog
from telenano.testing import SiteLauncher
from telenano.wire import Array, ConfigError, RecordingError, RecordingPiece, RefusedError, RigError

NAME, NS = "session_1.mcap", 1_000_000_000


@pytest.fixture
def far(tmp_path: Path) -> Path:
    """Give the folder of a far site with a recording of some pieces."""
    folder = tmp_path / "slave"
    writer = RecordingWriter.create("recorder@slave", FileSettings(directory=folder, file_name=NAME))
    noise = np.random.default_rng(1).bytes(3 * PIECE_BYTES + 77)
    writer.attach("noise", "application/octet-stream", noise, 0)
    writer.finish()
    return folder


class Sender:
    """A far site in virtual time, whose pieces a test may change on their way."""

    def __init__(
        self, folder: Path, change: Callable[[dict[str, Any]], dict[str, Any]] = lambda fields: fields
    ) -> None:
        self.sent: list[tuple[int, RecordingPiece]] = []
        self.now_ns = 0
        self._change = change
        self.pieces = PieceSender(folder, self._publish)

    def _publish(self, topic: str, **fields: Any) -> None:
        assert topic == "recording/piece"
        header = {"seq": len(self.sent), "t_ns": self.now_ns, "src": "launcher@slave", "v": 1}
        self.sent.append((self.now_ns, RecordingPiece(**header, **self._change(fields))))

    def ask(self, offset: int = 0, count: int = MOST_BYTES, rate: float = 1e6, name: Any = NAME, **other: Any) -> str:
        return self.pieces.request({FILE: name, OFFSET: offset, BYTES: count, RATE: rate, **other}, self.now_ns)

    def pass_s(self, duration_s: float) -> None:
        for _ in range(round(duration_s / 0.05)):
            self.now_ns += NS // 20
            self.pieces.send_due(self.now_ns)


def taken(sender: Sender, part: PartialFile) -> None:
    for _, piece in sender.sent:
        part.add(piece)
    sender.sent.clear()


def test_a_file_comes_in_pieces_and_is_the_same(far: Path, tmp_path: Path) -> None:
    sender, part = Sender(far), PartialFile(tmp_path / "far", NAME)
    sender.ask()
    sender.pass_s(1.0)
    assert len(sender.sent) > 3
    taken(sender, part)
    assert part.is_whole
    part.finish()
    assert (tmp_path / "far" / NAME).read_bytes() == (far / NAME).read_bytes()
    assert [path.name for path in (tmp_path / "far").iterdir()] == [NAME]


@pytest.mark.parametrize("kept", [0, 1, HEAD_BYTES - 1, HEAD_BYTES, PIECE_BYTES + 5, 3 * PIECE_BYTES])
def test_a_fetch_that_was_killed_goes_on_where_it_was(far: Path, tmp_path: Path, kept: int) -> None:
    whole = (far / NAME).read_bytes()
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / f"{NAME}.part").write_bytes(whole[:kept])
    sender, part = Sender(far), PartialFile(tmp_path / "far", NAME)
    assert part.offset == kept
    sender.ask(part.offset)
    sender.pass_s(1.0)
    assert sum(len(piece.data.to_numpy()) for _, piece in sender.sent) == len(whole) - kept
    taken(sender, part)
    part.finish()
    assert (tmp_path / "far" / NAME).read_bytes() == whole


def test_lost_and_repeated_pieces_are_asked_for_again(far: Path, tmp_path: Path) -> None:
    sender, part = Sender(far), PartialFile(tmp_path / "far", NAME)
    sender.ask()
    sender.pass_s(1.0)
    pieces = [piece for _, piece in sender.sent]
    assert part.add(pieces[0])
    assert not part.add(pieces[0])
    # one was lost: what follows does not count until it came
    assert not part.add(pieces[2])
    sender.sent.clear()
    sender.ask(part.offset)
    sender.pass_s(1.0)
    taken(sender, part)
    part.finish()
    assert (tmp_path / "far" / NAME).read_bytes() == (far / NAME).read_bytes()


@pytest.mark.parametrize("rate", [64.0, 1000.0, 8000.0])
def test_no_more_is_sent_than_the_rate_allows(far: Path, rate: float) -> None:
    sender = Sender(far)
    sender.ask(rate=rate)
    begin_ns = sender.now_ns
    sender.pass_s(20.0)
    total = 0
    for now_ns, piece in sender.sent:
        total += len(piece.data.to_numpy())
        assert total <= PIECE_BYTES + (now_ns - begin_ns) * 1e-9 * rate * 125.0 + 1
    sender.pieces.close()
    assert total >= min(20.0 * rate * 125.0 - PIECE_BYTES, (far / NAME).stat().st_size)


def test_a_stall_of_the_far_site_is_not_made_up_for_beyond_a_window(far: Path) -> None:
    sender = Sender(far)
    sender.ask(count=PIECE_BYTES)
    sender.now_ns += 3600 * NS
    sender.pieces.send_due(sender.now_ns)
    assert sum(len(piece.data.to_numpy()) for _, piece in sender.sent) == PIECE_BYTES


LIES: dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "another file": (lambda f: {**f, "file": "session_2.mcap"}, "where session_1.mcap was requested: refused"),
    "a path": (lambda f: {**f, "file": "../../.ssh/authorized_keys"}, "was requested: refused"),
    "an absolute path": (lambda f: {**f, "file": "/etc/passwd"}, "was requested: refused"),
    "another digest": (lambda f: {**f, "sha256": "0" * 64}, "that its digest contradicts: refused"),
    "no digest": (lambda f: {**f, "sha256": ""}, "that its digest contradicts: refused"),
    "bytes beyond the size": (lambda f: {**f, "size_bytes": f["offset_bytes"] + 1}, "bytes at 0 of 1: refused"),
    "an endless size": (lambda f: {**f, "size_bytes": 2**62}, "has room for"),
    "numbers": (
        lambda f: {**f, "data": Array.from_numpy(np.zeros(4)), "sha256": hashlib.sha256(bytes(32)).hexdigest()},
        "that its digest contradicts: refused",
    ),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_far_site_that_lies_is_refused(far: Path, tmp_path: Path, lie: str) -> None:
    change, text = LIES[lie]
    sender, part = Sender(far, change), PartialFile(tmp_path / "far", NAME)
    sender.ask()
    sender.pass_s(0.1)
    with pytest.raises(RecordingError, match=text):
        taken(sender, part)
    part.close()
    sender.pieces.close()
    # nothing of it is kept, and nothing is outside of the folder
    assert (tmp_path / "far" / f"{NAME}.part").stat().st_size == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["far", "slave"]


def test_a_file_that_becomes_shorter_and_one_that_grows(far: Path, tmp_path: Path) -> None:
    sender, part = Sender(far), PartialFile(tmp_path / "far", NAME)
    sender.ask()
    sender.pass_s(1.0)
    pieces = [piece for _, piece in sender.sent]
    part.add(pieces[0])
    with pytest.raises(RecordingError, match="after"):
        part.add(msgspec.structs.replace(pieces[1], size_bytes=pieces[1].size_bytes - 1))
    # a recorder that goes on recording: what there was at first is fetched
    for piece in pieces[1:]:
        part.add(msgspec.structs.replace(piece, size_bytes=piece.size_bytes + 1000))
    assert part.is_whole
    part.finish()


def test_what_an_earlier_attempt_left_of_another_recording_is_named(far: Path, tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / f"{NAME}.part").write_bytes(bytes(2 * HEAD_BYTES))
    sender, part = Sender(far), PartialFile(tmp_path / "far", NAME)
    sender.ask(part.offset)
    sender.pass_s(0.2)
    with pytest.raises(RecordingError, match=r"part: is of another recording than .*: remove it"):
        taken(sender, part)
    part.close()


def test_what_is_no_recording_is_not_kept(tmp_path: Path) -> None:
    (tmp_path / "slave").mkdir()
    (tmp_path / "slave" / NAME).write_bytes(b"no recording" * 1000)
    sender, part = Sender(tmp_path / "slave"), PartialFile(tmp_path / "far", NAME)
    sender.ask()
    sender.pass_s(0.2)
    taken(sender, part)
    with pytest.raises(RecordingError):
        part.finish()
    assert list((tmp_path / "far").iterdir()) == []


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        (
            {"name": "../scenario.yaml"},
            r"'../scenario.yaml' is not a part of the recording here, which has session_1.mcap",
        ),
        ({"name": "logs/afm_node@slave.log"}, "is not a part of the recording here"),
        ({"name": "session_1.mcap\n"}, "is not a part of the recording here"),
        ({"name": 7}, "7 is not a part of the recording here"),
        ({"name": "session_9.mcap"}, r"session_9.mcap cannot be read: No such file"),
        ({"offset": -1}, "must be whole numbers"),
        ({"offset": True}, "must be whole numbers"),
        ({"count": 0}, "must be whole numbers"),
        ({"count": MOST_BYTES + 1}, "must be whole numbers"),
        ({"rate": 1.0}, "must be a number from 64"),
        ({"rate": "fast"}, "must be a number from 64"),
        ({"afm_node.safety": 1}, r"afm_node.safety.? is not a part of the recording here"),
    ],
)
def test_a_wrong_request_is_refused_with_the_reason(far: Path, asked: dict[str, Any], text: str) -> None:
    with pytest.raises(RefusedError, match=text):
        Sender(far).ask(**asked)


def test_an_offset_at_the_end_tells_the_size(far: Path) -> None:
    sender = Sender(far)
    size = (far / NAME).stat().st_size
    sender.ask(size)
    sender.pass_s(0.2)
    ((_, piece),) = sender.sent
    assert (piece.size_bytes, piece.offset_bytes, len(piece.data.to_numpy())) == (size, size, 0)


@pytest.fixture
def book(tmp_path: Path) -> AddressBook:
    names = ("launcher@slave", "delay_node@slave", "console@master")
    sockets = Path(tempfile.mkdtemp(prefix="tn"))
    return AddressBook.model_validate({"nodes": {name: {"local": f"ipc://{sockets}/{name}"} for name in names}})


def test_what_was_asked_for_by_a_fetch_that_was_ended_is_none_of_the_next_one(
    far: Path, tmp_path: Path, book: AddressBook
) -> None:
    (far / "session_2.mcap").write_bytes(bytes(100 * PIECE_BYTES))

    def ended(name: str, done: int, size: int) -> None:
        raise KeyboardInterrupt

    with SiteLauncher(book, far, PieceSender):
        for _ in range(3):
            # the other site goes on with what it was asked for, a piece in 65 ms
            with pytest.raises(KeyboardInterrupt):
                fetch(book, ["session_2.mcap"], tmp_path / "far", kbit_per_s=8000.0, progress=ended)
            (fetched,) = fetch(book, [NAME], tmp_path / "far")
            assert fetched.read_bytes() == (far / NAME).read_bytes()
            fetched.unlink()


def test_a_fetch_goes_on_after_a_kill_and_after_a_silence_of_the_line(
    far: Path, tmp_path: Path, book: AddressBook
) -> None:
    whole, shown = (far / NAME).read_bytes(), []
    with SiteLauncher(book, far, PieceSender) as site:

        def ended(name: str, done: int, size: int) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fetch(book, [NAME], tmp_path / "far", progress=ended)
        kept = (tmp_path / "far" / f"{NAME}.part").read_bytes()
        assert 0 < len(kept) < len(whole)
        assert whole.startswith(kept)

        def silent_once(name: str, done: int, size: int) -> None:
            shown.append((done, size))
            if len(shown) == 1:
                site.runs.clear()
                threading.Timer(0.5, site.runs.set).start()

        assert fetch(book, [NAME], tmp_path / "far", progress=silent_once) == [tmp_path / "far" / NAME]
        with pytest.raises(RecordingError, match=r"launcher@slave refuses: session_7\.mcap cannot be read"):
            fetch(book, ["session_7.mcap"], tmp_path / "far")
    assert (tmp_path / "far" / NAME).read_bytes() == whole
    assert shown[0][0] > len(kept)
    assert shown[-1] == (len(whole), len(whole))
    # what is here already needs no other site
    assert fetch(book, [NAME], tmp_path / "far") == [tmp_path / "far" / NAME]


@pytest.fixture
def relayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AddressBook]:
    """Give the book of two sites that dial a relay, which runs, and the end of the slave's site with it."""
    with contextlib.ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in range(3)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        relay_port, launcher_port, link_port = (probe.getsockname()[1] for probe in probes)
    nodes = {
        "launcher@slave": {"network": f"tcp://{{slave}}:{launcher_port}"},
        "delay_node@slave": {"network": f"tcp://{{master}}:{link_port}", "machine": "master"},
        "console@master": {"local": f"ipc://{tempfile.mkdtemp(prefix='tn')}/console"},
    }
    machines = {"master": "192.0.2.1", "slave": "192.0.2.2"}
    book = AddressBook.model_validate({"machines": machines, "nodes": nodes, "relay": f"127.0.0.1:{relay_port}"})
    rings = {name: Keyring(tmp_path / f"keys-{name}") for name in ("master", "slave", "relay")}
    keys = {name: found.create(name).public.decode() for name, found in rings.items()}
    for site, other, roles in (("master", "slave", ["data"]), ("slave", "master", ["data", "control"])):
        rings[site].allow(other, keys[other], roles)
        rings[site].allow("relay", keys["relay"], ["relay"])
        rings["relay"].allow(site, keys[site], ["relay"])
    access = {name: AccessControl(name, rings[name], requires_keys=True) for name in ("relay", "slave")}

    async def run(ready: threading.Event, ends: threading.Event) -> None:
        relay = Relay(access["relay"], StructuredLog("relay"))
        await relay.start("127.0.0.1", relay_port)
        tasks = [relay.run(), SiteEnd(book, "slave", access["slave"], StructuredLog("relay@slave")).run()]
        running = [asyncio.create_task(task) for task in tasks]
        ready.set()
        await asyncio.to_thread(ends.wait)
        for task in running:
            task.cancel()
        await relay.close()

    ready, ends = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(run(ready, ends)))
    thread.start()
    assert ready.wait(10.0)
    yield book
    ends.set()
    thread.join()


def at_site(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, site: str) -> None:
    """Let what is opened next be of the machine of a site."""
    monkeypatch.setenv("TELENANO_MACHINE", site)
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path / f"keys-{site}"))


def test_a_fetch_is_at_the_relay_by_itself_and_leaves_it_again(
    far: Path, tmp_path: Path, relayed: AddressBook, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The rig has ended, and with it the end of this site at the relay.
    at_site(monkeypatch, tmp_path, "slave")
    with SiteLauncher(relayed, far, PieceSender):
        at_site(monkeypatch, tmp_path, "master")
        for folder in ("far", "again"):
            (fetched,) = fetch(relayed, [NAME], tmp_path / folder)
            assert fetched.read_bytes() == (far / NAME).read_bytes()
    assert "relay@master" not in {thread.name for thread in threading.enumerate()}


def test_a_fetch_without_the_key_of_the_relay_names_the_command(
    tmp_path: Path, relayed: AddressBook, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_site(monkeypatch, tmp_path, "master")
    Keyring().revoke("relay")
    with pytest.raises(ConfigError, match="telenano keys allow relay KEY --role relay"):
        fetch(relayed, [NAME], tmp_path / "far")


def test_a_site_that_is_not_there_is_named_and_nothing_is_lost(
    tmp_path: Path, book: AddressBook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(far_recording, "PATIENCE_NS", NS // 10)
    monkeypatch.setattr(far_recording, "_ASK_AGAIN_NS", NS // 10)
    (tmp_path / f"{NAME}.part").write_bytes(b"kept")
    with pytest.raises(RigError, match=r"launcher@slave has sent nothing of session_1\.mcap .* after 4 bytes"):
        fetch(book, [NAME], tmp_path)
    assert (tmp_path / f"{NAME}.part").read_bytes() == b"kept"
