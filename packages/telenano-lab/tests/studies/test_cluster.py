"""Studies on a real `dask scheduler` with real `dask worker`s: killed, lost, busy, and open to strangers."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cluster_cells import KIND, WaitingCell
from telenano_lab.studies.loops import sweep as sweeps
from telenano_lab.studies.loops.sweep import Journal, Sweep

from telenano.testing import free_ports
from telenano.wire import ConfigError

distributed = pytest.importorskip("dask.distributed")

pytestmark = [
    pytest.mark.check("starts a scheduler and workers of Dask"),
    pytest.mark.timeout(300),
]

DASK = Path(sys.executable).with_name("dask")
CELLS = [WaitingCell(number) for number in range(60)]
PATIENCE_S = 120.0


class Cluster:
    """A scheduler and its workers, each started as a person does, by the commands of docs/scale.md."""

    def __init__(self, folder: Path, *options: str, scheme: str = "tcp") -> None:
        self.port = free_ports(1)[0]
        self.address = f"{scheme}://127.0.0.1:{self.port}"
        self.options, self._folder = options, folder
        self.workers: list[subprocess.Popen[bytes]] = []
        self._all: list[subprocess.Popen[bytes]] = []
        self.start_scheduler()

    def _start(self, *arguments: str) -> "subprocess.Popen[bytes]":
        here = Path(__file__).parent
        environment = {**os.environ, "PYTHONPATH": f"{here}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
        with (self._folder / f"{arguments[0]}.log").open("ab") as log:
            made = subprocess.Popen(
                [DASK, *arguments, *self.options, "--no-dashboard"],
                stdout=log,
                stderr=log,
                cwd=self._folder,
                env=environment,
            )
        self._all.append(made)
        return made

    def start_scheduler(self) -> None:
        host = self.address.rpartition(":")[0]
        self.scheduler = self._start("scheduler", "--host", host, "--port", str(self.port))
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            try:
                socket.create_connection(("127.0.0.1", self.port), timeout=1.0).close()
                return
            except OSError:
                time.sleep(0.1)
        raise AssertionError((self._folder / "scheduler.log").read_text())

    def start_workers(self, count: int) -> None:
        for _ in range(count):
            # Without a nanny, which would start a worker that was killed again.
            self.workers.append(self._start("worker", self.address, "--nthreads", "1", "--no-nanny"))

    def close(self) -> None:
        for process in self._all:
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    made = Cluster(tmp_path)
    yield made
    made.close()


def sweep_of(tmp_path: Path, address: str, **more: Any) -> Sweep:
    return Sweep(Journal(tmp_path / "journal.jsonl", KIND), 1, address, **more)


@pytest.mark.check("starts a scheduler and workers of Dask, takes 9 s")
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/")
def test_a_worker_that_is_killed_in_mid_study_costs_no_cell(tmp_path: Path, cluster: Cluster) -> None:
    cluster.start_workers(2)
    killed: list[int] = []

    def progress(done: int, total: int) -> None:
        if done >= 10 and not killed:
            killed.append(cluster.workers[0].pid)
            cluster.workers[0].send_signal(signal.SIGKILL)

    found = sweep_of(tmp_path, cluster.address, progress=progress).run(CELLS)
    assert [result.cell for result in found] == CELLS
    assert killed
    # The other one ran what the killed one had.
    last = [result.process for result in found if result.process != killed[0]]
    assert len(last) >= len(CELLS) - 10 - KIND.batch
    lines = (tmp_path / "journal.jsonl").read_text().splitlines()
    assert len(lines) == len(CELLS)


@pytest.mark.check("starts a scheduler and workers of Dask, takes 9 s")
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/")
def test_a_scheduler_that_is_lost_is_named_and_the_study_goes_on_from_its_journal(
    tmp_path: Path, cluster: Cluster
) -> None:
    cluster.start_workers(1)

    def progress(done: int, total: int) -> None:
        if done >= 10:
            cluster.scheduler.send_signal(signal.SIGKILL)

    with pytest.raises(ConfigError, match=r"scheduler was lost, \d+ of 30 batches .* repeat the command to continue"):
        sweep_of(tmp_path, cluster.address, progress=progress).run(CELLS)
    kept = len((tmp_path / "journal.jsonl").read_text().splitlines())
    assert 10 <= kept < len(CELLS)
    cluster.scheduler.wait()
    cluster.start_scheduler()
    cluster.start_workers(1)
    again = sweep_of(tmp_path, cluster.address)
    assert [result.cell for result in again.run(CELLS)] == CELLS
    assert again.computed == len(CELLS) - kept


def test_a_second_study_that_waits_says_for_what(
    tmp_path: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.start_workers(1)
    monkeypatch.setattr(sweeps, "_WORKER_S", 2.0)
    with distributed.Client(cluster.address, timeout="60s") as other:
        other.wait_for_workers(1, timeout=PATIENCE_S)
        # Each of the two keeps the worker until the study has said that it waits.
        has_said = distributed.Event("said", client=other)
        busy = [other.submit(distributed.Event.wait, has_said, f"{PATIENCE_S} s", pure=False) for _ in range(2)]
        heard: list[str] = []

        def warn(text: str) -> None:
            heard.append(text)
            has_said.set()

        found = sweep_of(tmp_path, cluster.address, warn=warn).run(CELLS[:2])
        assert [result.cell for result in found] == CELLS[:2]
        other.cancel(busy)
    (text,) = heard
    said = f"--scheduler {cluster.address}: its workers first finish "
    assert re.fullmatch(re.escape(said) + "[12] tasks of other programs", text)


def test_a_stranger_who_reaches_the_port_runs_what_he_likes(cluster: Cluster) -> None:
    # The page says so, and why the port belongs on 127.0.0.1 or behind TLS.
    with distributed.Client(cluster.address, timeout="60s") as stranger:
        assert stranger.run_on_scheduler(os.getpid) == cluster.scheduler.pid


@pytest.fixture
def keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Make an authority and a pair of keys as the page does, and have this process and its children use them."""
    command = "openssl req -x509 -newkey rsa:2048 -nodes -days 365 -subj /CN=cluster -keyout c.key -out c.pem"
    subprocess.run(command.split(), cwd=tmp_path, check=True, capture_output=True)
    files = {"CA_FILE": "c.pem", "SCHEDULER__CERT": "c.pem", "SCHEDULER__KEY": "c.key"}
    files |= {
        f"{who}__{what}": f"c.{end}" for who in ("WORKER", "CLIENT") for what, end in (("CERT", "pem"), ("KEY", "key"))
    }
    found = {f"DASK_DISTRIBUTED__COMM__TLS__{key}": str(tmp_path / name) for key, name in files.items()}
    found["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] = "True"
    for key, value in found.items():
        monkeypatch.setenv(key, value)
    return found


# A program of its own, as a stranger's is: what Dask keeps of a client that was refused can stop the next one in the
# same process for ever, because its destructor waits for a lock that the next one's start holds.
STRANGER = """
import os, sys
from dask.distributed import Client
try:
    with Client(sys.argv[1], timeout="5s") as stranger:
        print(stranger.run_on_scheduler(os.getpid))
except (OSError, ValueError, TypeError):
    print("refused")
"""


def answer(address: str) -> str:
    """Return what a program with the environment of this one is told that asks a scheduler for its process."""
    command = [sys.executable, "-c", STRANGER, address]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S).stdout.strip()


def test_with_tls_a_study_runs_and_a_stranger_is_refused(
    tmp_path: Path, keys: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import dask

    cluster = Cluster(tmp_path, scheme="tls")
    try:
        cluster.start_workers(1)
        # A process reads its environment when it begins.
        dask.config.refresh()
        found = sweep_of(tmp_path, cluster.address).run(CELLS[:4])
        assert [result.cell for result in found] == CELLS[:4]
        assert answer(cluster.address) == str(cluster.scheduler.pid)
        for key in keys:
            monkeypatch.delenv(key)
        for address in (cluster.address, cluster.address.replace("tls", "tcp")):
            assert answer(address) == "refused", address
    finally:
        cluster.close()
        for key in keys:
            monkeypatch.delenv(key, raising=False)
        dask.config.refresh()
