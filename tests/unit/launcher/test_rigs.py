"""Rigs of one machine: whose name, folder and processors are whose, and what a killed one leaves behind."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from telenano.launcher import processors, rigs
from telenano.launcher.plan import Plan, UpRequest, make_plan
from telenano.launcher.rigs import own_rig, running_rigs
from telenano.launcher.run import reserved_folder
from telenano.runtime.bus.endpoint_lock import EndpointLock
from telenano.runtime.bus.local_endpoint import RIG_VARIABLE, is_rig_name, rig_directory, runtime_directory
from telenano.runtime.loop.realtime import PROCESSORS_VARIABLE
from telenano.wire.errors import ConfigError, RigError

WAIT_S = 60.0


@pytest.fixture(autouse=True)
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A runtime folder of its own, and a machine with four processors on which SCHED_FIFO is permitted."""
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.delenv(RIG_VARIABLE, raising=False)
    monkeypatch.delenv(PROCESSORS_VARIABLE, raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2, 3})
    monkeypatch.setattr(rigs, "may_use_fifo", lambda priority: True)
    return tmp_path / "run"


@pytest.fixture
def locks(tmp_path: Path) -> Path:
    folder = tmp_path / "locks"
    folder.mkdir()
    return folder


def plan_of(tmp_path: Path, *settings: str, **options: Any) -> Plan:
    return make_plan(UpRequest(scenario="fig12", out=tmp_path / "out", settings=settings, **options), tmp_path)


def test_each_rig_has_a_name_a_folder_and_two_processors(tmp_path: Path, base: Path, locks: Path) -> None:
    said: list[str] = []
    plan = plan_of(tmp_path)
    with own_rig(plan, said.append, locks) as first:
        assert (first.name, first.processors, said) == ("main", (2, 3), [])
        assert (runtime_directory(), os.environ[PROCESSORS_VARIABLE]) == (base, "2,3")
        # The second one is another process, which has no rig yet.
        del os.environ[RIG_VARIABLE]
        with own_rig(plan, said.append, locks) as second:
            assert (second.name, second.processors) == ("2", (0, 1))
            assert (runtime_directory(), os.environ[PROCESSORS_VARIABLE]) == (base / "rig-2", "0,1")
            assert base.stat().st_mode & 0o777 == (base / "rig-2").stat().st_mode & 0o777 == 0o700
            [text] = said
            assert text.startswith(f"rig main is in use by process {os.getpid()}; this one is rig 2")
            about = {rig.name: rig.about for rig in running_rigs()}
            assert {name: facts["processors"] for name, facts in about.items()} == {"main": [2, 3], "2": [0, 1]}
            assert processors.held({0, 1, 2, 3}, locks) == (0, 1, 2, 3)
        assert not (base / "rig-2").exists()
        assert [rig.name for rig in running_rigs()] == ["main"]
        assert processors.held({0, 1, 2, 3}, locks) == (2, 3)
        assert runtime_directory() == base
    assert running_rigs() == []
    assert not {RIG_VARIABLE, PROCESSORS_VARIABLE} & set(os.environ)


def test_a_rig_adds_to_what_it_says_of_itself_while_it_runs(tmp_path: Path, base: Path, locks: Path) -> None:
    with own_rig(plan_of(tmp_path), lambda text: None, locks) as own:
        assert own.place is not None
        for felt in ("not known: no session runs", "0.40 (0.39 to 0.41) times", "0.40 (0.39 to 0.41) times"):
            own.place.note(felt=felt)
            [rig] = running_rigs()
            assert (rig.about["felt"], rig.about["scenario"]) == (felt, "fig12")
            # It is the rig that has written it anew, and nobody has removed it.
            assert own.place.lost() == ""
    assert running_rigs() == []


def test_a_rig_without_processors_of_its_own_is_told_so_and_runs_behind(tmp_path: Path, locks: Path) -> None:
    taken = processors.claim_these({1, 2, 3}, locks)
    said: list[str] = []
    with own_rig(plan_of(tmp_path), said.append, locks) as own:
        assert own.processors == ()
        assert os.environ[PROCESSORS_VARIABLE] == "none"
        # the one that is free stays free
        assert processors.held({0, 1, 2, 3}, locks) == (1, 2, 3)
        [rig] = running_rigs()
        assert rig.about["behind"]
    assert "other rigs use processors 1, 2, 3 of 4; it runs behind them" in said[0]
    assert "realtime.rate_hz" in said[0]
    processors.release(taken)


@pytest.mark.parametrize(
    ("setting", "held", "variable"),
    [
        ("realtime.cpus=free", (), None),
        ("realtime.scheduler=normal", (), None),
        ("realtime.cpus={afm_node: 1}", (1,), None),
    ],
)
def test_a_scenario_that_places_its_nodes_claims_no_others(
    tmp_path: Path, locks: Path, setting: str, held: tuple[int, ...], variable: str | None
) -> None:
    with own_rig(plan_of(tmp_path, setting), lambda text: None, locks) as own:
        assert own.processors == held
        assert os.environ.get(PROCESSORS_VARIABLE) is variable


def test_a_processor_that_is_named_and_held_is_warned_of(tmp_path: Path, locks: Path) -> None:
    taken, said = processors.claim_these({1}, locks), []
    with own_rig(plan_of(tmp_path, "realtime.cpus={afm_node: 1, controller: 2}"), said.append, locks) as own:
        assert own.processors == (2,)
    assert said == ["warning: realtime.cpus: other rigs use processors 1 too, and both will be late there"]
    processors.release(taken)


def test_a_name_that_is_given_is_taken_or_refused(tmp_path: Path, locks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rigs, "_GLANCE_S", 0.0)
    monkeypatch.setenv(RIG_VARIABLE, "lab")
    with own_rig(plan_of(tmp_path), lambda text: None, locks) as own:
        assert own.name == "lab"
        refused = pytest.raises(RigError, match=r"rig lab is in use by process \d+: stop it, or give .* --rig NAME")
        with refused, own_rig(plan_of(tmp_path), lambda text: None, locks):
            pass
    assert os.environ[RIG_VARIABLE] == "lab"


@pytest.mark.parametrize("name", ["", "Lab", "../up", "a/b", "x" * 17, "-a", "ä", "a b"])
def test_what_cannot_be_part_of_a_path_is_no_name(
    tmp_path: Path, locks: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    assert not is_rig_name(name)
    plan = plan_of(tmp_path)
    monkeypatch.setenv(RIG_VARIABLE, name or "_")
    with pytest.raises(ConfigError, match="cannot name a rig"), own_rig(plan, lambda text: None, locks):
        pass


def test_a_folder_in_which_no_socket_has_room_is_named(
    tmp_path: Path, locks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = 107 - len(str(tmp_path)) - len("/haptic_node@master") - 3
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / ("r" * room)))
    plan = plan_of(tmp_path)
    with own_rig(plan, lambda text: None, locks):
        del os.environ[RIG_VARIABLE]
        with pytest.raises(ConfigError, match="longer than the 107 bytes"), own_rig(plan, lambda text: None, locks):
            pass


def test_a_site_file_with_ports_is_not_moved_aside(
    tmp_path: Path, locks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rigs, "_GLANCE_S", 0.0)
    monkeypatch.setenv("TELENANO_HOST_MASTER", "127.0.0.1")
    monkeypatch.setenv("TELENANO_HOST_SLAVE", "127.0.0.1")
    with own_rig(plan_of(tmp_path, site="slave"), lambda text: None, locks) as own:
        assert (own.name, own.processors) == ("main", (3,))
        # the other site of the same rig, on the same machine
        del os.environ[RIG_VARIABLE]
        with own_rig(plan_of(tmp_path, site="master"), lambda text: None, locks) as other:
            assert (other.name, other.processors) == ("main", (1, 2))
        with (
            pytest.raises(RigError, match="rig main is in use"),
            own_rig(plan_of(tmp_path, site="slave"), lambda text: None, locks),
        ):
            pass


def test_a_session_with_nodes_that_run_already_takes_nothing(tmp_path: Path, base: Path, locks: Path) -> None:
    with own_rig(plan_of(tmp_path, attach=True), lambda text: None, locks) as own:
        assert own == rigs.Own("main")
        assert not base.exists()


def test_what_a_killed_rig_left_is_removed_and_what_runs_is_not(tmp_path: Path, base: Path, locks: Path) -> None:
    dead, alive = base / "rig-dead", base / "rig-alive"
    for folder in (base, dead, alive):
        folder.mkdir(mode=0o700)
    for name in (
        "rig@master.lock",
        "rig@master.json",
        "afm_node@slave",
        "afm_node@slave.lock",
        "afm_node@slave.estop.kept",
    ):
        (dead / name).write_text("4194305")
    node = EndpointLock(f"ipc://{alive}/afm_node@slave")
    with own_rig(plan_of(tmp_path), lambda text: None, locks):
        assert not dead.exists()
        assert (alive / "afm_node@slave.lock").exists()
    node.release()


HOLDER = """
import os, subprocess, sys, time
from pathlib import Path
os.sched_getaffinity = lambda process: set(range(8))
from telenano.launcher import rigs
rigs.may_use_fifo = lambda priority: True
from telenano.launcher.plan import UpRequest, make_plan
folder, locks, begin_s = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
plan = make_plan(UpRequest(scenario="fig12", out=folder / "out"), folder)
time.sleep(max(0.0, begin_s - time.time()))
with rigs.own_rig(plan, lambda text: None, locks) as own:
    command = [sys.executable, "-c", "import time; time.sleep(600)"]
    node = subprocess.Popen(command, pass_fds=own.descriptors, stdout=subprocess.DEVNULL, start_new_session=True)
    print(own.name, *own.processors, node.pid, flush=True)
    sys.stdin.readline()
    node.kill()
    node.wait()
"""


@contextlib.contextmanager
def holders(tmp_path: Path, locks: Path, count: int, begin_s: float = 0.0) -> Iterator[list[subprocess.Popen[str]]]:
    command = [sys.executable, "-c", HOLDER, str(tmp_path), str(locks), str(begin_s)]
    pipe = subprocess.PIPE
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)) for _ in range(count)]


def facts_of(holder: subprocess.Popen[str]) -> tuple[str, tuple[int, ...], int]:
    assert holder.stdout is not None
    name, *numbers = holder.stdout.readline().split()
    return name, tuple(map(int, numbers[:-1])), int(numbers[-1])


@pytest.mark.check("takes 4.4 s")
def test_rigs_that_start_at_the_same_instant_get_names_and_processors_of_their_own(tmp_path: Path, locks: Path) -> None:
    with holders(tmp_path, locks, 4, time.time() + 3.0) as started:
        found = [facts_of(holder) for holder in started]
        for holder in started:
            holder.communicate("\n", timeout=WAIT_S)
    assert sorted(name for name, _, _ in found) == ["2", "3", "4", "main"]
    assert sorted(number for _, own, _ in found for number in own) == list(range(8))


@pytest.mark.check("takes 1.5 s")
def test_a_name_that_another_command_only_looks_at_is_waited_for(tmp_path: Path, base: Path, locks: Path) -> None:
    plan = plan_of(tmp_path)
    with holders(tmp_path, locks, 1) as [holder]:
        assert facts_of(holder)[0] == "main"
        # The first rig takes the lock so, when it looks whether a killed one left the folder.
        glance = EndpointLock(f"ipc://{base}/rig-2/rig@master")
        ended = threading.Timer(0.3, glance.release)
        ended.start()
        with own_rig(plan, lambda text: None, locks) as second:
            assert second.name == "2"
        ended.join()
        holder.communicate("\n", timeout=WAIT_S)


@pytest.mark.check("takes 1.4 s")
def test_a_rig_killed_with_its_nodes_leaves_its_name_and_processors_free(
    tmp_path: Path, base: Path, locks: Path
) -> None:
    with holders(tmp_path, locks, 1) as [launcher]:
        name, own, node = facts_of(launcher)
        assert (name, own) == ("main", (6, 7))
        launcher.kill()
        launcher.wait()
        # A node that has not ended yet may be moving its device, so it keeps both.
        assert [rig.name for rig in running_rigs()] == ["main"]
        assert processors.held(set(range(8)), locks) == own
        ended = threading.Timer(0.5, os.kill, (node, signal.SIGKILL))
        ended.start()
        # The launcher is gone, so the next one waits for the nodes and does not become a second rig.
        with own_rig(plan_of(tmp_path), lambda text: None, locks) as next_one:
            assert next_one.name == "main"
        ended.join()
    assert processors.held(set(range(8)), locks) == ()
    assert running_rigs() == []


def test_of_claims_at_once_each_gets_all_that_it_needs_or_nothing(locks: Path) -> None:
    for _ in range(10):
        found: list[dict[int, int]] = []

        def claim(claimed: list[dict[int, int]] = found) -> None:
            claimed.append(processors.claim(2, range(8), locks))

        threads = [threading.Thread(target=claim) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(map(len, found)) == [0, 0, 2, 2, 2, 2]
        assert sorted(number for claimed in found for number in claimed) == list(range(8))
        for claimed in found:
            processors.release(claimed)


def test_a_lock_that_cannot_be_opened_counts_as_held(locks: Path) -> None:
    (locks / "telenano-processor-3.lock").symlink_to(locks / "elsewhere")
    assert processors.held({2, 3}, locks) == (3,)
    assert not (locks / "elsewhere").exists()


def test_sessions_of_the_same_second_have_folders_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    now = datetime(2026, 1, 2, 3, 4, 5)
    with reserved_folder("fig12", now) as first, reserved_folder("fig12", now) as second:
        assert (first.name, second.name) == ("fig12-20260102-030405", "fig12-20260102-030405-2")
        (second / "session.mcap").touch()
    assert not first.exists()
    assert second.exists()


def test_the_folder_of_the_first_rig_is_that_of_all(base: Path) -> None:
    assert rig_directory("main") == rig_directory("") == base
    assert rig_directory("2") == base / "rig-2"
