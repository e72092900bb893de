"""A rig whose folder, sockets or locks are removed under way: it is found, stopped and commanded, or makes itself safe.

The parts of it are in `tests/unit/runtime/test_places.py`; a random order of losses and commands is at the end.
"""

import contextlib
import json
import os
import random
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest
from ledger import record
from stack_rig import BOTH_WAYS, CONSTANT_PUSH, Rig, apart, mode

from telenano.runtime.bus.local_endpoint import is_bound

HAND, TIP = "haptic_node@master", "afm_node@slave"
# A user that is not this one.
STRANGER = 4711
RATE = ("--set", "realtime.rate_hz=250")
NODES = (HAND, TIP, "controller@master", "controller@slave", "delay_node@master", "delay_node@slave",
         "launcher@master", "recorder@master")  # fmt: skip


def removed(folder: Path) -> None:
    # Its nodes make it again while it is removed.
    shutil.rmtree(folder, ignore_errors=True)


def replaced(folder: Path) -> None:
    removed(folder)
    folder.mkdir(mode=0o700, exist_ok=True)


def moved(folder: Path) -> None:
    with contextlib.suppress(FileNotFoundError):
        # It may not have been made again since the last time.
        folder.rename(f"{folder}-{time.monotonic_ns()}")


def without(*patterns: str) -> Callable[[Path], None]:
    def remove(folder: Path) -> None:
        for pattern in patterns:
            for path in folder.glob(pattern):
                path.unlink(missing_ok=True)

    return remove


LOSSES = {
    "folder removed": removed,
    "folder replaced by a new one": replaced,
    "folder moved away": moved,
    "socket of the AFM removed": without(TIP),
    "inlet of the AFM removed": without(f"{TIP}.estop"),
    "sockets of both devices removed": without(f"{TIP}*", f"{HAND}*"),
    "lock of the AFM removed": without(f"{TIP}.lock"),
    "locks of the rig removed": without("rig@*"),
    "every lock removed": without("*.lock"),
}


def paths(rig: Rig) -> set[str]:
    """Return the names of the nodes whose socket answers, and whose lock stands at its path."""
    return {
        node for node in NODES if is_bound(f"ipc://{rig.sockets}/{node}") and (rig.sockets / f"{node}.lock").exists()
    }


def is_whole(rig: Rig) -> bool:
    return paths(rig) == set(NODES) and (rig.sockets / "rig@master.lock").exists()


def listed(rig: Rig) -> dict[str, int]:
    """Return the process of each rig that `status --all` lists."""
    done = rig.telenano("status", "--all", "--json")
    assert done.returncode == 0, done.stderr
    return {row["rig"]: row["process"] for row in json.loads(done.stdout)["rigs"]}


def assert_stopped(rig: Rig, *options: str) -> None:
    stopped = rig.telenano("estop", "--json", *options)
    assert stopped.returncode == 0, stopped.stdout + stopped.stderr
    answers = json.loads(stopped.stdout)["answers"]
    assert {node.rpartition("/")[2] for node in answers} == {HAND, TIP}
    assert {answer["kind"] for answer in answers.values()} == {"ack"}


def start(rig: Rig) -> Rig:
    rig.start("--duration", "600", "--set", CONSTANT_PUSH, rate=RATE)
    rig.wait_until(rig.running, "a running session")
    return rig


@pytest.fixture
def pair(tmp_path: Path, processes: str) -> Iterator[list[Rig]]:
    """Two rigs of one user, which have one runtime folder."""
    both = [Rig(tmp_path / name, processes) for name in ("1", "2")]
    both[1].sockets, both[1].environment = both[0].sockets, both[0].environment
    yield both
    for rig in both:
        rig.close()


@BOTH_WAYS
@pytest.mark.endurance
def test_a_second_rig_sees_the_first_and_outlives_it(pair: list[Rig]) -> None:
    first, second = pair
    start(first)
    removed(first.sockets)
    start(second)
    assert first.process is not None
    assert second.process is not None
    assert listed(second) == {"main": first.process.pid, "2": second.process.pid}
    removed(first.sockets)
    stopped = second.telenano("estop", "--json")
    assert stopped.returncode == 0, stopped.stdout + stopped.stderr
    devices = {f"{name}/{node}" for name in ("main", "2") for node in (HAND, TIP)}
    assert set(json.loads(stopped.stdout)["answers"]) == devices
    code, _, err = first.stop()
    assert code == 0, err
    assert listed(second) == {"2": second.process.pid}
    folder = second.sockets / "rig-2"
    assert all(is_bound(f"ipc://{folder}/{node}") for node in NODES)
    assert_stopped(second, "--rig", "2")
    record(
        f"a second rig is started after the folder of the first was removed{first.way}",
        "it was rig 2 and kept its sockets",
    )


@BOTH_WAYS
@pytest.mark.endurance
def test_a_folder_that_is_replaced_by_that_of_another_rig_is_given_back_or_the_rig_is_made_safe(
    tmp_path: Path, processes: str
) -> None:
    with closing(Rig(tmp_path / "1", processes)) as first, closing(Rig(tmp_path / "2", processes)) as second:
        start(first)
        start(second)
        while first.sockets.exists():
            removed(first.sockets)
        second.sockets.rename(first.sockets)
        assert_stopped(second)
        second.wait_until(lambda: mode(second) == "estop", "the tip in emergency stop")
        second.wait_until(lambda: is_whole(second), "its paths")
        assert second.process is not None
        assert listed(second) == {"main": second.process.pid}
        stopped = first.telenano("estop", "--json")
        assert first.process is not None
        if stopped.returncode == 0:
            first.wait_until(lambda: is_whole(first), "its paths")
            assert listed(first) == {"main": first.process.pid}
        else:
            # The second rig was so late in leaving the folder that the first has given up its name.
            code, _, err = first.finish()
            assert code == 1, stopped.stderr + err
            assert "no command reaches this rig any more" in err
        assert is_whole(second), "the end of one rig has removed what another one has"
        if processes == "site":
            # The process of the tip ends so soon after that of the hand that no command is missed before: it withdraws
            # the tip after its last state.
            assert first.log_has(TIP, '"stopped"')
            assert not first.log_has(TIP, "no retraction of the tip")
        else:
            assert first.recording().messages("afm/state")[-1].decode().mode != "follow"


def taken_by_a_file(folder: Path) -> None:
    folder.write_text("what stands here is no folder")


def taken_by_another_user(folder: Path) -> None:
    # The folder is that of the other user from the moment on at which it is there.
    made = folder.with_name(f"{folder.name}-made")
    made.mkdir(mode=0o700)
    os.chown(made, STRANGER, STRANGER)
    try:
        made.rename(folder)
    except OSError:
        made.rmdir()
        raise FileExistsError(folder) from None


@BOTH_WAYS
@pytest.mark.parametrize(
    ("take", "asked"),
    [
        pytest.param(taken_by_a_file, False, marks=pytest.mark.endurance),
        pytest.param(taken_by_a_file, True, marks=pytest.mark.endurance),
        pytest.param(
            taken_by_another_user,
            True,
            marks=pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/", "telenano/console/"),
        ),
    ],
)
def test_devices_that_cannot_have_their_paths_again_are_made_safe(
    rig: Rig, take: Callable[[Path], None], asked: bool
) -> None:
    if take is taken_by_another_user and os.geteuid():
        pytest.skip("only root can make the folder of another user")
    start(rig)
    for _ in range(1000):
        removed(rig.sockets)
        # Its nodes may have made it again already.
        with contextlib.suppress(FileExistsError, IsADirectoryError):
            take(rig.sockets)
            break
    else:
        pytest.fail("the folder was made again each time")
    if asked:
        stopped = rig.telenano("estop")
        # A command that begins late finds no process, because the rig has made its devices safe and ended them.
        if rig.process_of(TIP) is not None or rig.process_of(HAND) is not None:
            assert "was found" not in stopped.stderr
            assert "got the stop by a signal" in stopped.stderr
    code, _, err = rig.finish()
    if rig.sockets.is_dir():
        # Root's devices can keep their stop there; nothing else is made in a folder of another user.
        assert all(path.name.endswith(".estop.kept") for path in rig.sockets.iterdir())
        shutil.rmtree(rig.sockets)
    else:
        rig.sockets.unlink()
    assert code == 1
    assert "no command reaches this rig any more" in err
    assert "its devices were made safe" in err
    states = [found.decode() for found in rig.recording().messages("afm/state")]
    at = next(place for place, state in enumerate(states) if state.mode == "estop")
    assert {state.mode for state in states[at:]} == {"estop"}
    base_m = [state.base_position_m[2] for state in states[at:]]
    # Towards the sample is down.
    assert max(before - after for before, after in pairwise(base_m)) <= 0.0
    record(
        f"the runtime folder is removed and cannot be made again{rig.way}", "both devices stopped; the rig ended with 1"
    )


# --- a random order of all that may happen to the paths of a rig ---


def follows(rig: Rig) -> bool:
    return mode(rig) in ("follow", "place")


@BOTH_WAYS
@pytest.mark.drawn(0.0, "telenano/runtime/bus/", "telenano/console/")
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.endurance)])
def test_in_any_order_a_stop_is_obeyed_and_no_rig_is_called_absent(pair: list[Rig], seed: int) -> None:
    draw, rig = random.Random(seed), start(pair[0])
    assert rig.process is not None
    # How long an undisturbed rig takes to obey, from the command to the state in the recording.
    begun_s = time.monotonic()
    assert_stopped(rig)
    rig.wait_until(lambda: mode(rig) == "estop", "an undisturbed stop")
    usual_s = time.monotonic() - begun_s
    happened: list[str] = []
    for _ in range(10):
        what = draw.choice([*LOSSES, "arm", "arm", "kill a controller", "list", "stop"])
        happened.append(what)
        if what in LOSSES:
            LOSSES[what](rig.sockets)
        elif what == "arm":
            armed = rig.telenano("session", "arm", "--json")
            if armed.returncode:
                # A node that is being started again has not answered, which is said as it is.
                assert "was found" not in armed.stderr, (happened, armed.stderr)
        elif what == "kill a controller":
            with contextlib.suppress(AssertionError):
                rig.kill(draw.choice(["controller@slave", "controller@master"]))
        elif what == "list":
            assert listed(rig) == {"main": rig.process.pid}, happened
        elif what == "stop":
            ended = rig.telenano("session", "stop")
            assert "was found" not in ended.stderr, (happened, ended.stderr)
        if draw.random() < 0.5:
            continue
        LOSSES[lost := draw.choice([*LOSSES])](rig.sockets)
        happened += [lost, "estop"]
        begun_s = time.monotonic()
        stopped = rig.telenano("estop", "--json")
        assert stopped.returncode == 0, (happened, stopped.stdout + stopped.stderr)
        rig.wait_until(lambda: mode(rig) == "estop", f"a stop obeyed after {happened}")
        # Two looks at the paths, and an answer as usual.
        assert time.monotonic() - begun_s < 5.0 * usual_s + 2.0, happened
    for other in rig.sockets.parent.glob(f"{rig.sockets.name}-*"):
        shutil.rmtree(other)
    code, _, err = rig.stop()
    assert code in (0, 3), (happened, err)


# --- one rig for all tests below, in the order in which they are written ---


@pytest.fixture(scope="module")
def losing(tmp_path_factory: pytest.TempPathFactory, processes: str) -> Iterator[Rig]:
    """Run a rig whose paths are removed over and over, after the tests that have the machine for two rigs."""
    with closing(Rig(tmp_path_factory.mktemp("losing"), processes)) as rig:
        yield start(rig)
        for other in rig.sockets.parent.glob(f"{rig.sockets.name}-*"):
            shutil.rmtree(other)


# `make check` tries the loss of everything, of a socket and of a lock; the others are its parts.
IN_CHECK = ("folder removed", "socket of the AFM removed", "locks of the rig removed")


@BOTH_WAYS
@pytest.mark.parametrize(
    "loss", [loss if loss in IN_CHECK else pytest.param(loss, marks=pytest.mark.endurance) for loss in LOSSES]
)
def test_a_rig_whose_paths_are_removed_is_found_stopped_and_commanded(losing: Rig, loss: str) -> None:
    rig, lose = losing, LOSSES[loss]
    rig.wait_until(lambda: is_whole(rig), "the paths of the test before")
    process = rig.process
    assert process is not None
    lose(rig.sockets)
    assert_stopped(rig)
    rig.wait_until(lambda: mode(rig) == "estop", "the tip in emergency stop")
    lose(rig.sockets)
    assert listed(rig) == {"main": process.pid}
    lose(rig.sockets)
    armed = rig.telenano("session", "arm", "--json")
    assert armed.returncode == 0, armed.stdout + armed.stderr
    assert set(json.loads(armed.stdout)["answers"]) >= {HAND, TIP}
    lose(rig.sockets)
    state = rig.telenano("status", "--json")
    assert "no node reports" not in state.stderr, state.stderr
    assert {row["node"] for row in json.loads(state.stdout)["nodes"] if row["heard"]} >= {HAND, TIP}
    lose(rig.sockets)
    ended = rig.telenano("session", "stop")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    rig.wait_until(lambda: is_whole(rig), "the paths made again")
    assert rig.log_has("launcher@master", "made again") or rig.log_has(TIP, "made again")


@BOTH_WAYS
def test_it_says_so_and_its_recording_lacks_nothing(losing: Rig) -> None:
    rig = losing
    removed(rig.sockets)
    for node in ("launcher@master", TIP, HAND):
        said = "was removed or replaced while this process ran; it was made again"
        rig.wait_until(lambda n=node, text=said: rig.log_has(n, text), f"the word of {node}")
    rig.wait_until(lambda: is_whole(rig), "the paths made again")
    for topic in ("afm/state", "haptic/state", "session/event"):
        for node in {found.decode().src for found in rig.recording().messages(topic)} & set(NODES):
            seqs = [state.seq for found in rig.recording().messages(topic) if (state := found.decode()).src == node]
            assert seqs == list(range(seqs[0], seqs[0] + len(seqs))), f"messages of {node} on {topic} are missing"
    record(f"the runtime folder is removed under a rig{rig.way}", "made again; stopped, armed and listed at once")


def armed_tip(rig: Rig) -> None:
    """Arm the tip, again where the arm met a late copy of a stop and is void, until no stop holds it."""
    rig.wait_until(lambda: rig.telenano("session", "arm", "--target", "afm_node").returncode == 0, "the AFM armed")
    rig.wait_until(lambda: mode(rig) != "estop", "a tip in no emergency stop")


@apart("the AFM answers the stop while the half beside it is started again")
def test_a_node_that_is_started_again_in_the_gap_opens_no_way_for_an_arm_that_a_stop_has_not(losing: Rig) -> None:
    rig = losing
    rig.wait_until(lambda: is_whole(rig), "the paths of the test before")
    removed(rig.sockets)
    rig.kill("controller@slave")
    assert_stopped(rig)
    rig.wait_until(lambda: rig.log_has("launcher@master", "controller@slave was started again"), "the restart")
    armed_tip(rig)
    removed(rig.sockets)
    assert_stopped(rig)
    rig.wait_until(lambda: mode(rig) == "estop", "the tip in emergency stop")


@BOTH_WAYS
def test_a_stop_for_an_instrument_that_is_started_again_in_the_gap_is_kept_for_it(losing: Rig) -> None:
    rig = losing
    rig.wait_until(lambda: is_whole(rig), "the paths of the test before")
    # The tip is in no stop before, so that the one which is seen afterwards is this one.
    armed_tip(rig)
    removed(rig.sockets)
    rig.kill(TIP)
    # Whoever restarts it has not made the folder again yet, or just has.
    removed(rig.sockets)
    rig.telenano("estop")
    rig.wait_until(lambda: rig.log_has("launcher@master", f"{TIP} was started again"), "the restart")
    rig.wait_until(lambda: mode(rig) == "estop", "the tip in emergency stop")
    record(
        f"an emergency stop while the AFM is being started again without a folder{rig.way}",
        "it came back in emergency stop",
    )
