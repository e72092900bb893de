"""The file of the recording from the page: who gets it, by which address, and that no other file is ever sent."""

import asyncio
import os
import random
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from http.client import HTTPConnection, IncompleteRead
from pathlib import Path
from typing import Any

import msgpack
import pytest
from bus_page import ACCESS
from bus_page import BusPage as Page
from made_source import MadeSource

from telenano.testing import PATIENCE_S, until

pytest.importorskip("starlette")
pytest.importorskip("httpx2")
from starlette.testclient import TestClient

from services.viz_node import recording_files, server
from services.viz_node.__main__ import recording_of
from services.viz_node.hub import Hub
from services.viz_node.page_session import Session
from services.viz_node.recording_files import ELSEWHERE, Download, RecordingFiles, open_recording
from services.viz_node.requests import RecordingRequest
from telenano.recording.mcap_scan import MAGIC
from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.serving.access import Role
from telenano.serving.connections import Connections
from telenano.serving.serve import bind, make_server
from telenano.wire.errors import RefusedError

SECRET = b"-----BEGIN KEY-----"


def written(folder: Path, *, finished: bool, number: int = 0) -> Path:
    """Write a recording, to its end or as a running recorder has it."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder), number)
    writer.flush()
    so_far = writer.path.read_bytes()
    writer.finish({"state": "complete"})
    if not finished:
        writer.path.write_bytes(so_far)
    return writer.path


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    found = tmp_path / "session"
    found.mkdir()
    return found


@pytest.fixture
def hub(folder: Path, clock: Clock) -> Hub:
    files = RecordingFiles.of_recorder(folder, "session.mcap")
    files._clock = clock
    return Hub(MadeSource(), recording=files)


@pytest.fixture
def client(hub: Hub) -> Iterator[TestClient]:
    with TestClient(server.make_app(hub, ACCESS, None), client=("127.0.0.1", 5)) as found:
        yield found


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def test_an_operator_gets_the_file_of_the_running_and_of_the_ended_session(
    client: TestClient, stack: ExitStack, folder: Path
) -> None:
    paths = [written(folder, finished=True), written(folder, finished=False, number=1)]
    page = Page(stack, client)
    rows = page.ask(k="recording")["found"]["files"]
    assert [(row["name"], row["is_finished"], row["why"]) for row in rows] == [
        ("session.mcap", True, ""),
        ("session_1.mcap", False, ""),
    ]
    for path, name in zip(paths, ["session.mcap", "session_1.unfinished.mcap"], strict=True):
        answer = client.get(page.ask(k="recording", name=path.name)["found"]["address"])
        assert answer.headers["content-disposition"] == f"attachment; filename*=UTF-8''{name}"
        assert answer.content == path.read_bytes()
        copy = folder.parent / name
        copy.write_bytes(answer.content)
        # What the recorder has not finished can be read as well.
        assert Recording(copy).metadata.keys() == Recording(path).metadata.keys()


def test_an_address_is_valid_once_for_a_minute_and_while_its_page_is_there(
    client: TestClient, stack: ExitStack, folder: Path, clock: Clock, hub: Hub
) -> None:
    written(folder, finished=True)
    page = Page(stack, client)

    def address() -> str:
        return str(page.ask(k="recording", name="session.mcap")["found"]["address"])

    once, late, kept = address(), address(), address()
    # What only asks for the head does not use the address up.
    assert client.head(once).status_code == 405
    assert [client.get(once).status_code for _ in range(2)] == [200, 404]
    clock.now_s = recording_files.VALID_S - 0.1
    assert client.get(late).status_code == 200
    clock.now_s += 0.1
    assert client.get(kept).status_code == 404
    orphan = address()
    for session in list(hub.sessions):
        hub.leave(session)
    assert client.get(orphan).status_code == 404
    assert client.get("/recording/made-up").status_code == 404


def test_addresses_that_nobody_uses_do_not_pile_up(client: TestClient, stack: ExitStack, folder: Path) -> None:
    written(folder, finished=True)
    page = Page(stack, client)
    addresses = [page.ask(k="recording", name="session.mcap")["found"]["address"] for _ in range(20)]
    codes = [client.get(address).status_code for address in addresses]
    assert codes == [404] * 4 + [200] * 16


def test_observers_and_participants_get_neither_list_nor_address(
    client: TestClient, stack: ExitStack, folder: Path, hub: Hub
) -> None:
    written(folder, finished=True)
    page = Page(stack, client, ACCESS.observer_token)
    for name in ("", "session.mcap"):
        answer = page.ask(k="recording", name=name)
        assert (answer["ok"], answer.get("found")) == (False, None)
        assert "only the page of an operator" in answer["text"]
    guest, portal = Session(Role.PARTICIPANT), client.portal
    assert portal is not None
    hub.sessions.add(guest)
    portal.call(hub.handle, guest, RecordingRequest("a", "session.mcap"), 0.0)
    answer = msgpack.unpackb(guest._answers.pop())
    assert (answer["ok"], "found" in answer) == (False, False)
    assert hub.desk.refused.rejected["role"] == 3


def test_no_name_leads_to_a_file_that_is_not_of_the_recording(
    client: TestClient, stack: ExitStack, folder: Path
) -> None:
    """Names are drawn from pieces that lead elsewhere; whatever they are, the secret is not sent."""
    written(folder, finished=True)
    (folder.parent / "session.mcap").write_bytes(MAGIC + SECRET)
    for name in ("key.mcap", "session_x.mcap", "session.mcap.bak", "xsession.mcap", "session_1.mcap\n"):
        (folder / name).write_bytes(MAGIC + SECRET)
    page, draw = Page(stack, client), random.Random(1)
    pieces = ["..", "/", "session", ".mcap", "_x", "key", str(folder), "\\", "%2e%2e", "\0", "\n", "_1", ".bak", "x"]
    names = ["".join(draw.choices(pieces, k=draw.randint(1, 5))) for _ in range(150)]
    names += [path.name for path in folder.iterdir()] + [str(path) for path in folder.parent.iterdir()]
    given = set()
    for name in names:
        answer = page.ask(k="recording", name=name[:256])
        if answer["ok"] and name:
            given.add(name)
            assert SECRET not in client.get(answer["found"]["address"]).content
    assert given == {"session.mcap"}
    for name in ("../session.mcap", "%2e%2e/session.mcap", "..%2fsession.mcap"):
        assert client.get(f"/recording/{name}").status_code == 404


def test_what_stands_under_the_name_of_a_recording_and_is_none_is_refused_with_its_reason(
    client: TestClient, stack: ExitStack, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = folder.parent / "secret.mcap"
    secret.write_bytes(MAGIC + SECRET)
    (folder / "session.mcap").symlink_to(secret)
    os.mkfifo(folder / "session_1.mcap")
    (folder / "session_2.mcap").mkdir()
    (folder / "session_3.mcap").write_bytes(SECRET)
    (folder / "session_4.mcap").write_bytes(b"")
    (folder / "session_5.mcap").write_bytes(MAGIC)
    real_open = os.open

    def forbidden(path: Any, flags: int) -> int:
        if str(path).endswith("_5.mcap"):
            raise PermissionError(13, "Permission denied")
        return real_open(path, flags)

    monkeypatch.setattr(recording_files.os, "open", forbidden)
    page = Page(stack, client)
    whys = {row["name"]: row["why"] for row in page.ask(k="recording")["found"]["files"]}
    assert whys == {
        "session.mcap": "session.mcap is a symbolic link, which is not followed",
        "session_1.mcap": "session_1.mcap is no regular file",
        "session_2.mcap": "session_2.mcap is no regular file",
        "session_3.mcap": "session_3.mcap is no recording: it does not begin as one",
        "session_4.mcap": "session_4.mcap is no recording: it does not begin as one",
        "session_5.mcap": "session_5.mcap cannot be read: Permission denied",
    }
    for name, why in whys.items():
        answer = page.ask(k="recording", name=name)
        assert (answer["ok"], answer["text"]) == (False, why)


def test_a_file_that_is_replaced_by_a_link_after_its_address_was_given_is_not_sent(
    client: TestClient, stack: ExitStack, folder: Path
) -> None:
    path = written(folder, finished=True)
    secret = folder.parent / "secret.mcap"
    secret.write_bytes(MAGIC + SECRET)
    address = Page(stack, client).ask(k="recording", name=path.name)["found"]["address"]
    path.unlink()
    path.symlink_to(secret)
    answer = client.get(address)
    assert (answer.status_code, SECRET in answer.content) == (404, False)


@pytest.mark.parametrize("place", [None, Path("relative"), Path("/nowhere/at/all")])
def test_a_recording_that_is_elsewhere_is_said_to_be_with_the_command_that_gets_it(place: Path | None) -> None:
    files = RecordingFiles.of_recorder(place, "session.mcap")
    assert files._list() == {"files": [], "why": ELSEWHERE}
    assert all(command in ELSEWHERE for command in ("record.status=true", "docker cp", "telenano bag fetch"))


def test_the_folder_is_that_of_the_scenario_which_the_launcher_gives(tmp_path: Path) -> None:
    path = written(tmp_path, finished=False)
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(f"recorder:\n  directory: {tmp_path}\n  file_name: session.mcap\n")
    assert [row["name"] for row in recording_of(scenario)._list()["files"]] == [path.name]
    scenario.write_text("duration_s: 5.0\n")
    assert recording_of(scenario)._list()["files"] == []


class Sent:
    """A browser that takes what is sent, and may go or stall."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.is_complete = False
        self.gone = threading.Event()

    async def receive(self) -> dict[str, Any]:
        while not self.gone.is_set():
            await asyncio.sleep(0.001)
        return {"type": "http.disconnect"}

    async def send(self, message: dict[str, Any]) -> None:
        if message["type"] == "http.response.body":
            self.parts.append(message["body"])
            self.is_complete = not message["more_body"]


def downloaded(path: Path, browser: Any, *, may_go_on: Any = lambda: True) -> tuple[bytes, bool, int]:
    """Return what a browser got, whether it was complete, and how often its connection was dropped."""
    dropped: list[int] = []

    def drop() -> None:
        dropped.append(1)
        browser.gone.set()

    opened = open_recording(path)
    asyncio.run(Download(opened, path.name, may_go_on, drop)({}, browser.receive, browser.send))
    assert opened.file.closed
    return b"".join(browser.parts), browser.is_complete, len(dropped)


@pytest.fixture
def large(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(recording_files, "PIECE_BYTES", 1 << 12)
    path = folder / "session.mcap"
    path.write_bytes(MAGIC + random.Random(2).randbytes(100_000))
    return path


def test_a_download_goes_in_pieces_up_to_the_size_at_its_beginning(large: Path) -> None:
    before, browser = large.read_bytes(), Sent()

    def grow() -> bool:
        with large.open("ab") as file:
            file.write(b"later")
        return True

    assert downloaded(large, browser, may_go_on=grow) == (before, True, 0)
    assert max(map(len, browser.parts)) <= 1 << 12


def test_a_download_that_breaks_off_is_dropped_and_never_looks_complete(
    large: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = large.read_bytes()
    # The address of its person is revoked.
    turns = iter([True] * 5 + [False])
    data, is_complete, drops = downloaded(large, Sent(), may_go_on=lambda: next(turns))
    assert (data, is_complete, drops) == (before[: 5 << 12], False, 1)

    class Leaving(Sent):
        async def send(self, message: dict[str, Any]) -> None:
            await super().send(message)
            if len(self.parts) == 3:
                self.gone.set()

    data, is_complete, _ = downloaded(large, Leaving())
    assert len(data) < len(before) // 2
    assert not is_complete

    class Stalled(Sent):
        async def send(self, message: dict[str, Any]) -> None:
            if len(self.parts) == 2:
                await asyncio.sleep(PATIENCE_S)
            await super().send(message)

    monkeypatch.setattr(recording_files, "STALLED_S", 0.05)
    data, is_complete, drops = downloaded(large, Stalled())
    assert (len(data), is_complete, drops) == (2 << 12, False, 1)

    def cut() -> bool:
        os.truncate(large, 20_000)
        return True

    data, is_complete, drops = downloaded(large, Sent(), may_go_on=cut)
    assert (data, is_complete, drops) == (before[:20_000], False, 1)


def test_a_third_download_waits_for_its_turn(
    hub: Hub, client: TestClient, stack: ExitStack, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(folder, finished=True)
    held, begun = threading.Event(), []

    def slow(path: Path) -> Any:
        begun.append(path)
        held.wait(PATIENCE_S)
        return open_recording(path)

    page = Page(stack, client)
    first, second, third = (page.ask(k="recording", name="session.mcap")["found"]["address"] for _ in range(3))
    monkeypatch.setattr(server, "open_recording", slow)
    codes: list[int] = []
    running = [
        threading.Thread(target=lambda address=address: codes.append(client.get(address).status_code))
        for address in (first, second)
    ]
    for each in running:
        each.start()
    assert until(lambda: len(begun) == 2)
    assert client.get(third).status_code == 503
    held.set()
    for each in running:
        each.join(PATIENCE_S)
    assert codes == [200, 200]
    # The refusal has not used its address up.
    assert client.get(third).status_code == 200


def test_given_files_are_those_of_the_owner_also_by_a_link(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    path = written(tmp_path / "far", finished=True)
    link = tmp_path / "link.mcap"
    link.symlink_to(path)
    assert [row["name"] for row in RecordingFiles.of_paths([link])._list()["files"]] == [path.name]
    with pytest.raises(RefusedError, match="symbolic link"):
        open_recording(link)


def test_a_download_over_a_port_that_is_revoked_ends_short_and_nothing_of_it_is_logged(
    folder: Path, large: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("uvicorn")
    hub = Hub(MadeSource(), recording=RecordingFiles.of_recorder(folder, "session.mcap"))
    session, connections = Session(Role.OPERATOR), Connections()
    with bind(port=0) as bound:
        found = make_server(server.make_app(hub, ACCESS, None, connections))
        hub.sessions.add(session)
        running = threading.Thread(target=found.run, kwargs={"sockets": [bound.again(connections)]})
        running.start()

        def fetched() -> tuple[bytes, str]:
            address = asyncio.run(hub.recording.answer(session, "session.mcap"))["address"]
            client = HTTPConnection(*bound.getsockname()[:2], timeout=PATIENCE_S)
            client.request("GET", f"/{address}", headers={"Host": "testserver"})
            with closing(client):
                try:
                    return client.getresponse().read(), address
                except IncompleteRead as error:
                    return error.partial, address

        whole, first = fetched()
        turns = iter([True] * 3 + [False])
        hub.may_have = lambda session: next(turns)  # type: ignore[method-assign]
        part, second = fetched()
        found.should_exit = True
        running.join(PATIENCE_S)
    assert (whole, part) == (large.read_bytes(), large.read_bytes()[: 3 << 12])
    written_anywhere = "".join(capfd.readouterr()) + caplog.text
    assert [text for text in (first, second, str(folder), "ASGI") if text in written_anywhere] == []
