"""The paths of a process: what is removed is missed, made again, and left alone where it is another's."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
import zmq

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.endpoint_lock import EndpointInUseError, EndpointLock
from telenano.runtime.bus.holders import STOP_SIGNAL, look
from telenano.runtime.bus.local_endpoint import bound_by, estop_endpoint, is_bound
from telenano.runtime.bus.pin import Pin
from telenano.runtime.bus.places import Places
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.wiring.transport import Transport
from telenano.settings import DEFAULT_SITE_FILE
from telenano.timing.clock import SystemClock
from telenano.wire.errors import EndpointError

TIP = "afm_node@slave"
WAIT_MS = 10_000


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "r"))
    monkeypatch.delenv("TELENANO_RIG", raising=False)
    return tmp_path / "r"


@pytest.fixture
def transport(folder: Path) -> Iterator[Transport]:
    with zmq.Context() as context:
        book = AddressBook.load(DEFAULT_SITE_FILE)
        with closing(Transport(context, SystemClock(), book, "")) as made:
            yield made


def replaced(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir(mode=0o700)


def moved(folder: Path) -> None:
    folder.rename(folder.with_name("moved"))


def without(*names: str) -> Callable[[Path], None]:
    def remove(folder: Path) -> None:
        for name in names:
            (folder / name).unlink()

    return remove


LOSSES = {
    "folder": shutil.rmtree,
    "replaced": replaced,
    "moved": moved,
    "socket": without(TIP),
    "inlet": without(f"{TIP}.estop"),
    "lock": without(f"{TIP}.lock"),
    "all": without(TIP, f"{TIP}.estop", f"{TIP}.lock"),
}


def read(socket: "zmq.Socket[bytes]", publisher: ZmqPublisher) -> bool:
    """Return whether a reader gets what is published, once it is connected."""
    for _ in range(WAIT_MS // 20):
        publisher.send("afm/state", b"x")
        if socket.poll(20):
            while socket.poll(0):
                socket.recv_multipart()
            return True
    return False


@pytest.mark.parametrize("loss", LOSSES)
def test_what_is_removed_is_made_again_and_nobody_is_cut_off(transport: Transport, folder: Path, loss: str) -> None:
    with closing(transport.publisher(TIP)) as publisher, closing(transport.estop_inlet(TIP)) as inlet:  # type: ignore[type-var]
        endpoint = f"ipc://{folder}/{TIP}"
        with zmq.Context() as context, context.socket(zmq.SUB) as early, context.socket(zmq.SUB) as late:
            for socket in (early, late):
                socket.subscribe(b"")
            early.connect(endpoint)
            assert read(early, publisher)
            assert (transport.places.look(), transport.places.are_kept()) == ([], True)
            LOSSES[loss](folder)
            assert not transport.places.are_kept()
            [holder] = look().at(str(folder / TIP))
            assert (holder.process, holder.node) == (os.getpid(), TIP)
            [notice] = transport.places.look()
            assert (notice.level, notice.state) == ("warning", "made_again")
            assert notice.path in {str(folder / name) for name in (TIP, f"{TIP}.lock", f"{TIP}.estop")}
            assert transport.places.are_kept()
            assert transport.places.look() == []
            assert is_bound(endpoint)
            assert is_bound(estop_endpoint(endpoint))
            assert folder.stat().st_mode & 0o777 == 0o700
            with pytest.raises(EndpointInUseError):
                EndpointLock(endpoint)
            late.connect(endpoint)
            assert read(late, publisher)
            assert read(early, publisher), "who was connected has lost the connection"
            assert inlet is not None
    assert list(folder.iterdir()) == []


def taken(endpoint: str) -> "subprocess.Popen[str]":
    """Start a process that takes an endpoint, as one of an earlier version does, and holds it until its input ends."""
    program = """
import sys, zmq
from telenano.runtime.bus import endpoint_lock
from telenano.runtime.bus.holders import Look
endpoint_lock.look = Look
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.timing.clock import SystemClock
with zmq.Context() as context:
    publisher = ZmqPublisher(context, SystemClock(), "afm_node@slave", sys.argv[1])
    print("held", flush=True)
    sys.stdin.read()
    publisher.close()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_what_another_process_has_by_now_is_left_alone(folder: Path, transport: Transport) -> None:
    publisher = transport.publisher(TIP)
    shutil.rmtree(folder)
    other = taken(f"ipc://{folder}/{TIP}")
    try:
        [notice] = transport.places.look()
        assert (notice.level, notice.state, transport.places.given_up) == ("error", "lost", False)
        assert f"is in use by process {other.pid}" in transport.places.obstacle
        # It is said once, and given up at the second look.
        assert transport.places.look() == []
        assert transport.places.given_up
        before = sorted((path.name, path.stat().st_ino) for path in folder.iterdir())
        publisher.close()
        assert sorted((path.name, path.stat().st_ino) for path in folder.iterdir()) == before
        peer = bound_by(f"ipc://{folder}/{TIP}")
        assert peer is not None
        assert (peer.process, peer.user, peer.is_trusted) == (other.pid, os.geteuid(), True)
    finally:
        other.communicate()


def test_who_comes_later_sees_a_process_whose_files_were_removed(folder: Path, transport: Transport) -> None:
    other = taken(f"ipc://{folder}/{TIP}")
    shutil.rmtree(folder)
    try:
        with pytest.raises(EndpointError, match=f"is in use by process {other.pid}"):
            transport.publisher(TIP)
        assert not (folder / f"{TIP}.lock").exists()
    finally:
        other.communicate()
    transport.publisher(TIP).close()


def test_what_another_process_gives_back_is_taken_again(folder: Path, transport: Transport) -> None:
    with closing(transport.publisher(TIP)):
        shutil.rmtree(folder)
        other = taken(f"ipc://{folder}/{TIP}")
        transport.places.look()
        transport.places.look()
        assert transport.places.given_up
        other.communicate()
        [notice] = transport.places.look()
        assert (notice.state, transport.places.obstacle, transport.places.given_up) == ("made_again", "", False)


@pytest.mark.parametrize("squat", ["file", "open", "foreign"])
def test_a_folder_that_is_not_ours_is_not_used(folder: Path, transport: Transport, squat: str) -> None:
    with closing(transport.publisher(TIP)):
        shutil.rmtree(folder)
        if squat == "file":
            folder.write_text("")
        else:
            folder.mkdir()
            folder.chmod(0o777 if squat == "open" else 0o700)
        if squat == "foreign":
            if os.geteuid():
                pytest.skip("only root can make the folder of another user")
            os.chown(folder, 4711, 4711)
        for _ in range(2):
            transport.places.look()
        assert transport.places.given_up
        assert str(folder) in transport.places.obstacle
        if squat != "file":
            assert list(folder.iterdir()) == []


def test_a_later_file_is_not_taken_for_an_earlier_one(tmp_path: Path) -> None:
    # The number of an inode is given to the next file that is made, which is here made at once.
    for number in range(20):
        pins = []
        for _ in range(2):
            path = tmp_path / f"{number}"
            path.write_text("")
            pins.append(Pin(path))
            path.unlink()
        path.write_text("")
        assert [pin.is_in_place() for pin in pins] == [False, False]
        for pin in pins:
            pin.remove()
        assert path.exists()


def test_a_place_that_fails_in_another_way_is_told_anew() -> None:
    class Lost:
        fault = "first"

        def lost(self) -> str:
            return "/p"

        def make_again(self) -> None:
            if self.fault:
                raise EndpointError(self.fault)

    places, place = Places(), Lost()
    places.add(place)
    assert ["first" in notice.text for notice in places.look()] == [True]
    place.fault = "second"
    assert ["second" in notice.text for notice in places.look()] == [True]
    place.fault = ""
    assert [notice.state for notice in places.look()] == ["made_again"]


def test_a_lock_keeps_its_descriptor_for_processes_that_are_started_later(tmp_path: Path) -> None:
    lock = EndpointLock(f"ipc://{tmp_path}/r/rig@master")
    descriptors = lock.descriptors
    shutil.rmtree(tmp_path / "r")
    assert lock.lost() == f"{tmp_path}/r/rig@master.lock"
    lock.make_again()
    assert (lock.descriptors, lock.lost()) == (descriptors, "")
    command = [sys.executable, "-c", "import time; time.sleep(60)", "telenano"]
    child = subprocess.Popen(command, pass_fds=descriptors)
    lock.release()
    # The kernel knows the command of a process a moment after it was started.
    end_s = time.monotonic() + WAIT_MS * 1e-3
    while not look().at(f"{tmp_path}/r/rig@master") and time.monotonic() < end_s:
        time.sleep(0.01)
    # What was inherited is held on, and its file is gone with the process that took it.
    [holder] = look().at(f"{tmp_path}/r/rig@master")
    assert (holder.process, holder.owner) == (child.pid, str(os.getpid()))
    child.kill()
    child.wait()
    assert look().at(f"{tmp_path}/r/rig@master") == []


def test_who_only_looks_at_a_lock_or_has_another_file_is_no_holder(tmp_path: Path) -> None:
    lock = EndpointLock(f"ipc://{tmp_path}/{TIP}")
    with (tmp_path / f"{TIP}.lock").open():
        assert [holder.node for holder in look().at(f"{tmp_path}/{TIP}")] == [TIP]
    lock.release()
    (tmp_path / f"{TIP}.lock").write_text(f"1\n{TIP}\n{tmp_path}/{TIP}\n")
    with (tmp_path / f"{TIP}.lock").open():
        assert look().at(f"{tmp_path}/{TIP}") == []


@pytest.mark.skipif(STOP_SIGNAL is None, reason="this system has no such signal")
def test_a_process_that_would_be_ended_by_the_signal_does_not_get_it(tmp_path: Path) -> None:
    process = taken(f"ipc://{tmp_path}/{TIP}")
    [holder] = look().at(f"{tmp_path}/{TIP}")
    assert not holder.takes_signal
    assert not holder.signal_stop()
    assert not holder._replace(takes_signal=True).signal_stop(), "the process is asked again"
    assert process.poll() is None
    process.communicate()


def test_a_process_that_takes_the_signal_gets_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert STOP_SIGNAL is not None
    taken_at: list[int] = []
    signal.signal(STOP_SIGNAL, lambda number, frame: taken_at.append(number))
    lock = EndpointLock(f"ipc://{tmp_path}/{TIP}")
    try:
        shutil.rmtree(tmp_path)
        [holder] = look().at(f"{tmp_path}/{TIP}")
        assert holder.signal_stop()
        end_s = time.monotonic() + WAIT_MS * 1e-3
        while not taken_at and time.monotonic() < end_s:
            time.sleep(0.01)
        assert taken_at == [STOP_SIGNAL]
        # The number of a process that has another endpoint by now is that of another one.
        assert not holder._replace(node="haptic_node@master").signal_stop()
    finally:
        lock.release()
