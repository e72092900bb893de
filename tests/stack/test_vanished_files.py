"""Whatever a rig was started with vanishes under way, and each of its processes is killed: each comes back as it was.

The folder of sockets and its locks are in `test_lost_paths.py`, full disks in `test_full_disk.py`, keys in
`tests/unit/launcher/test_held.py`.
"""

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml
from ledger import record
from stack_rig import CONSTANT_PUSH, Rig, arm, mode

from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.descriptors import needed_by
from telenano.settings.included import NETWORK_DIRECTORY, SCENARIO_DIRECTORY, SITE_DIRECTORY

RECORDER = "recorder@master"
NODES = ("controller@slave", "delay_node@master", "haptic_node@master", "controller@master", "afm_node@slave", RECORDER)


class Given(Rig):
    """A rig whose every file is the test's own: site file, scenario, sample, trace, network and working folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.given = folder / "given"
        self.working_folder = self.given / "work"
        (self.given / "networks").mkdir(parents=True)
        self.working_folder.mkdir()
        self.environment["TELENANO_NETWORKS"] = str(self.given / "networks")
        shutil.copy(SITE_DIRECTORY / "local.yaml", self.given / "site.yaml")
        shutil.copy(NETWORK_DIRECTORY / "lan.yaml", self.given / "networks" / "ours.yaml")
        (self.given / "trace.txt").write_text("0 0.001\n1 0.001\n")
        np.save(self.given / "flat.npy", np.zeros((16, 16)))
        document = yaml.safe_load((SCENARIO_DIRECTORY / "fig12.yaml").read_text())
        document["delay_node"] = {"profile": "ours", "forward": {"delay_trace": {"file": "trace.txt"}}}
        document["afm_node"]["sample"] = {"name": str(self.given / "flat.npy"), "size_m": 1e-6}
        (self.given / "ours.yaml").write_text(yaml.safe_dump(document))

    def begin(self) -> None:
        """Start a session that presses, and wait until it runs."""
        self.start(
            "--site-file", str(self.given / "site.yaml"), "--duration", "600", "--set", CONSTANT_PUSH,
            scenario=str(self.given / "ours.yaml"), rate=("--set", "realtime.rate_hz=250"),
        )  # fmt: skip
        self.wait_until(self.running, "a running session")

    def end_and_await(self, numbers: dict[str, signal.Signals]) -> None:
        """End processes by a signal each, and wait until their successors are at work."""
        before = {node: self.process_of(node) for node in numbers}
        for node, number in numbers.items():
            process_id = before[node]
            assert process_id is not None, f"{node} does not run"
            os.kill(process_id, number)
        for node in numbers:
            self.wait_until(lambda node=node: self.process_of(node) not in (None, before[node]), f"a new {node}")
            process_id = self.process_of(node)
            self.wait_until(lambda node=node, own=process_id: self.is_heard(node, own), f"{node} at work")

    def is_heard(self, node: str, process_id: int | None) -> bool:
        """Return whether a recording has a report of a process since it has been at work."""
        if not any(self.out.glob("session*.mcap")):
            return False
        rows = self.recording().messages("node/health")
        return any((health := row.decode()).src == node and health.pid == process_id for row in rows[-40:])


def gone(*names: str) -> Callable[[Given], None]:
    def remove(rig: Given) -> None:
        for name in names:
            path = rig.folder / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return remove


VANISHING = {
    "scenario": gone("given/ours.yaml"),
    "site file": gone("given/site.yaml"),
    "sample": gone("given/flat.npy"),
    "trace": gone("given/trace.txt"),
    "network": gone("given/networks"),
    "effective scenario": gone("out/scenario.yaml"),
    "folder of logs": gone("out/logs"),
    "working folder": gone("given/work"),
    "folder of the recording": gone("out"),
    "folder of sockets": lambda rig: shutil.rmtree(rig.sockets, ignore_errors=True),
}


def begun(folder: Path) -> Iterator[Given]:
    with closing(Given(folder)) as rig:
        rig.begin()
        yield rig


def assert_sound(rig: Given) -> None:
    """Assert that the devices wait for a person, obey one, and that the session ends with what it is made again of."""
    assert mode(rig) != "follow", "a tip that was started again follows without an arm"
    arm(rig)
    assert rig.telenano("session", "start").returncode == 0
    rig.wait_until(lambda: rig.session_s() > 0.5, "the force of the hand")
    code, summary, err = rig.stop()
    assert code in (0, 3), err
    assert summary
    files = sorted(rig.out.glob("session*.mcap"))
    # A recorder that is killed as it makes its removed file again leaves one without a channel.
    begun_files = [path for path in files if Recording(path).channels]
    assert begun_files
    for path in begun_files:
        assert {"site.yaml", "scenario.yaml"} <= set(Recording(path).attachments), path
    assert open_recordings(files).messages("afm/state")
    assert (rig.out / "scenario.yaml").exists()


@pytest.mark.check("takes 15 s")
@pytest.mark.drawn(0.0, "telenano/launcher/", "telenano/signals/", "telenano/files/")
def test_all_that_a_rig_was_started_with_vanishes_and_each_of_its_processes_comes_back(tmp_path: Path) -> None:
    for rig in begun(tmp_path):
        book = AddressBook.load(rig.given / "site.yaml")
        for node in NODES:
            # What is looked at before the start is no less than what a node has open.
            opened = len(list(Path(f"/proc/{rig.process_of(node)}/fd").iterdir()))
            assert opened <= needed_by(book, node, 8).needed, node
        for name in ("given", "out"):
            gone(name)(rig)
        # All six start for twice as long, and are in the table of `make endurance`.
        rig.end_and_await({NODES[1]: signal.SIGKILL, "afm_node@slave": signal.SIGABRT, RECORDER: signal.SIGKILL})
        assert_sound(rig)
        fault = "all files that a rig was started with, and the folders that it writes to, are removed, and each node"
        record(f"{fault} is killed or aborted", "all came back; made again, recorded, armed and going on")


@pytest.mark.endurance("takes 3 min")
def test_each_thing_vanishes_and_each_process_is_killed_and_aborted(tmp_path: Path) -> None:
    for rig in begun(tmp_path):
        for number, vanish in enumerate(VANISHING.values()):
            vanish(rig)
            for place, node in enumerate(NODES):
                rig.end_and_await({node: (signal.SIGKILL, signal.SIGABRT)[(place + number) % 2]})
        assert_sound(rig)
