"""Each file that several processes change: no change is lost, no disk is too full for a sentence, no kill leaves half.

The table has a row for each shared file of the core; those of packages are in the tests of the packages.
"""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from services.viz_node.lease_desk import LeaseDesk
from telenano.console.lease import Lease, Party, current, take
from telenano.console.lease_register import Hold, LeaseRegister
from telenano.files.atomic_files import changed, locked
from telenano.runtime.loop import kept_stop
from telenano.runtime.security.keyring import Keyring
from telenano.serving.people import People
from telenano.serving.serve import announced
from telenano.testing import Shared, SharedFiles, race, small_disk
from telenano.wire.errors import RigError

ROUNDS = 12
KEYS = [f"{'0' * 36}{number:04}" for number in range(300)]


def no_keys(folder: Path) -> None:
    ring = Keyring(folder)
    for number in range(ROUNDS):
        ring.allow(f"v{number}", KEYS[number], ["data"])


def change_keys(folder: Path, who: int, number: int) -> None:
    if who == 0:
        Keyring(folder).allow(f"w{number}", KEYS[100 + number], ["observe"])
    else:
        Keyring(folder).revoke(f"v{number}")


def lost_keys(folder: Path, done: list[set[int]]) -> object:
    keys = Keyring(folder).allowed().keys
    allowed = {key.name for key in keys if not key.revoked}
    revoked = {key.name for key in keys if key.revoked}
    return [n for n in done[0] if f"w{n}" not in allowed], [n for n in done[1] if f"v{n}" not in revoked]


def lost_pairs(folder: Path, done: list[set[int]]) -> object:
    """Return the machines whose key pair two commands had made, as both said, and those whose halves differ."""
    ring = Keyring(folder)
    return sorted(done[0] & done[1]), [text for name in ring.names() if (text := ring.misplaced(name))]


def people(folder: Path) -> None:
    for number in range(ROUNDS):
        People(folder).add(f"v{number}", "operator", 60.0)


def change_people(folder: Path, who: int, number: int) -> None:
    if who == 0:
        People(folder).add(f"w{number}", "operator", 60.0)
    else:
        People(folder).revoke(f"v{number}")


def lost_people(folder: Path, done: list[set[int]]) -> object:
    known = {person.name: person for person in People(folder)._all()}
    return (
        [n for n in done[0] if f"w{n}" not in known or known[f"w{n}"].revoked],
        [n for n in done[1] if not known[f"v{n}"].revoked],
    )


def count(folder: Path, who: int, number: int) -> None:
    LeaseRegister(folder).change(lambda lease, now_ns: lease._replace(number=lease.number + 1))


def lost_counts(folder: Path, done: list[set[int]]) -> object:
    return len(done[0]) + len(done[1]) - LeaseRegister(folder).look().number


SHARED = (
    Shared("allowed keys", no_keys, change_keys, lambda *a: [each for each in lost_keys(*a) if each]),
    Shared(
        "key pairs",
        lambda folder: None,
        lambda folder, who, number: Keyring(folder).create(f"k{number}"),
        lambda *a: [each for each in lost_pairs(*a) if each],
    ),
    Shared("people of the page", people, change_people, lambda *a: [each for each in lost_people(*a) if each]),
    Shared("the lease of the hand", lambda folder: None, count, lost_counts),
)


@pytest.mark.parametrize("shared", SHARED, ids=[shared.name for shared in SHARED])
class TestEachSharedFile(SharedFiles):
    rounds = ROUNDS


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_kill_at_any_moment_leaves_the_whole_of_one_content_and_no_lock(tmp_path: Path) -> None:
    path = tmp_path / "shared"
    contents = {bytes([65 + number]) * 200_000 for number in range(2)}

    def write_for_ever() -> None:
        while True:
            for content in sorted(contents):
                changed(path, lambda _, content=content: content, is_forced=False)  # type: ignore[misc]

    for round_ in range(10):
        child = os.fork()
        if child == 0:
            write_for_ever()
        time.sleep(0.003 + 0.001 * round_)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        assert not path.exists() or path.read_bytes() in contents
        with locked(path, 0.0):
            pass
    changed(path, lambda before: b"end")
    assert sorted(found.name for found in tmp_path.iterdir()) == ["shared", "shared.lock"]


def test_what_the_system_refuses_is_a_sentence_and_a_lock_that_stays_is_named(tmp_path: Path) -> None:
    for name in ("lock", "file"):
        path = tmp_path / name
        (Path(f"{path}.lock") if name == "lock" else path).mkdir()
        with pytest.raises(RigError, match=f"{path}: cannot be .*: Is a directory"):
            changed(path, lambda before: b"x")
    path = tmp_path / "held"
    with locked(path), pytest.raises(RigError, match=f"{path}: another process has had it for 0.01 s"):
        changed(path, lambda before: b"x", wait_s=0.01)


def test_an_emergency_stop_of_two_writers_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "stop"
    payloads = [bytes([65 + who]) * 3000 for who in (0, 1)]
    stop = Shared(
        "stop",
        lambda folder: None,
        lambda folder, who, number: kept_stop.keep(path, payloads[who]),
        lambda *_: None,
    )
    seen, over = set(), threading.Event()

    def read() -> None:
        while not over.is_set():
            seen.add(kept_stop.kept(path))

    reader = threading.Thread(target=read)
    reader.start()
    race(stop, tmp_path, ROUNDS)
    over.set()
    reader.join()
    assert seen <= {None, *payloads}


def test_threads_of_one_process_do_not_take_the_file_of_each_other(tmp_path: Path) -> None:
    path, faults = tmp_path / "stop", list[str]()

    def write(content: bytes) -> None:
        for _ in range(50):
            if fault := kept_stop.keep(path, content):
                faults.append(fault)

    threads = [threading.Thread(target=write, args=(bytes([65 + number]) * 3000,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert faults == []
    assert len(set(path.read_bytes())) == 1 and [found.name for found in tmp_path.iterdir()] == ["stop"]


@pytest.mark.check("fills a folder")
def test_who_has_the_hand_keeps_it_in_a_full_folder_and_others_are_refused_by_name(tmp_path: Path) -> None:
    register = LeaseRegister(tmp_path / "disk")
    with small_disk(tmp_path / "disk") as leave:
        party, other = Party("1"), Party("t", "Tina")
        hold = Hold(party, register, lambda lease, now_ns: take(lease, party, now_ns))
        leave(0)
        with pytest.raises(RigError, match=r"disk/lease: cannot be changed: No space left on device"):
            register.change(lambda lease, now_ns: take(lease, other, now_ns, from_anyone=True))
        seen_ns = register.look().seen_ns
        # longer than a holder may be silent
        time.sleep(1.3)
        assert hold.is_held()
        assert register.look().seen_ns > seen_ns
        desk = LeaseDesk(register)
        desk.tick((), time.monotonic())
        assert desk.lease.holder == party
        (tmp_path / "disk" / "filler").unlink()
        assert register.change(lambda lease, now_ns: take(lease, other, now_ns, from_anyone=True)).holder == other
        assert not hold.is_held()
        hold.end()


def test_a_server_begins_where_its_address_cannot_be_kept_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, shown = tmp_path / "disk", list[str]()
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(disk))
    with small_disk(disk) as leave:
        leave(0)
        with announced({"view": "http://127.0.0.1:8650/#secret"}, shown.append):
            pass
        assert shown[1] == f"view: the address cannot be kept: {disk}/view-8650.addresses: No space left on device"
        assert "secret" not in "".join(shown)


def test_a_folder_that_others_can_reach_ends_no_loop_and_no_sign_of_life(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(folder))
    register, party = LeaseRegister(), Party("1")
    hold = Hold(party, register, lambda lease, now_ns: take(lease, party, now_ns))
    desk = LeaseDesk(register)
    folder.chmod(0o777)
    with pytest.raises(RigError, match="other users can reach its content"):
        register.change(current)
    # longer than between two signs of life
    time.sleep(0.4)
    desk.tick((), time.monotonic())
    folder.chmod(0o700)
    seen_ns = register.look().seen_ns
    end_s = time.monotonic() + 10.0
    while register.look().seen_ns == seen_ns and time.monotonic() < end_s:
        time.sleep(0.05)
    assert hold.is_held()
    hold.end()


def test_a_holder_who_vanishes_in_a_full_folder_has_lost_the_hand(tmp_path: Path) -> None:
    register = LeaseRegister(tmp_path / "disk")
    with small_disk(tmp_path / "disk") as leave:
        register.change(lambda lease, now_ns: take(lease, Party("1"), now_ns)._replace(presses=True, seen_ns=1))
        kept = Lease(7, Party("1"), 1, kept=True, presses=True)
        (tmp_path / "disk" / "lease").write_bytes(b"")
        register.change(lambda lease, now_ns: kept)
        leave(0)
        found = register.look()
        assert (found.holder, found.withdraw) == (None, True)
        desk = LeaseDesk(register)
        desk.tick((), time.monotonic())
        assert desk.is_to_withdraw()
        # what cannot be kept ends the loop of the page no more than it repeats a withdrawal for ever
        desk.note_withdrawn(desk.lease.number)
        assert not desk.is_to_withdraw()
        assert register.look() == register.look()
        (tmp_path / "disk" / "filler").unlink()
        # it is kept once there is room, which withdraws the tip a last time
        assert desk.is_to_withdraw()
        desk.note_withdrawn(desk.lease.number)
        assert not desk.is_to_withdraw()
        assert register.change(current).holder is None
