"""What supervises outlives what it supervises: a launcher that is killed or aborted is started again by its unit.

The slave's site runs by the command and the rules of `deploy/telenano-slave.service`, with `supervisor.py` in place of
systemd; the master's is begun by a person. Between them is a cable that alters bytes of TCP behind a right checksum.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import machine
import psutil
import pytest
from ledger import record
from stack_rig import CONSTANT_PUSH
from two_sites import NOT_NEEDED, ROOT, Site, TwoSites, needs_namespaces
from wide_area_cable import WideAreaCable

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.timeout(580)]

UNIT = ROOT / "deploy" / "telenano-slave.service"
SUPERVISOR = Path(__file__).with_name("supervisor.py")
NS_PER_S = 1_000_000_000


class Service:
    """The slave's site as a service of the unit."""

    def __init__(self, site: Site, folder: Path) -> None:
        self.site, self.home, self.log = site, folder / "home", folder / "service.txt"
        self.home.mkdir()
        self.log.touch()
        further = ["--site-file", str(site.site_file), *site.rate]
        further += ["--set", f"recorder.exclude={json.dumps(NOT_NEEDED['slave'])}"]
        command = [sys.executable, str(SUPERVISOR), str(UNIT), str(self.log), *further]
        # The keys are those of the test, and its folder is that of the service.
        environment = {**site.environment, "PYTHONPATH": str(ROOT)}
        self.process = subprocess.Popen(
            site.cable.inside("slave", command), env=environment, cwd=self.home, preexec_fn=machine.usual_priority
        )

    def launchers(self) -> list[int]:
        """Return the processes of the launcher, the newest last."""
        return [int(number) for number in re.findall(r"^started (\d+)$", self.log.read_text(), re.MULTILINE)]

    def deaths(self) -> list[int]:
        """Return how the launchers ended, a negative number by a signal."""
        return [int(code) for code in re.findall(r"^ended \d+ with (-?\d+)$", self.log.read_text(), re.MULTILINE)]

    def folders(self) -> list[Path]:
        """Return the folders of its sessions, the newest last."""
        return sorted(self.home.glob("sessions/*"))

    def follow_newest(self) -> None:
        """Have the site read the newest recording of the service."""
        self.site.out = self.folders()[-1]

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(timeout=90.0)


@pytest.fixture
def supervised(tmp_path: Path) -> Iterator[tuple[TwoSites, WideAreaCable, Service]]:
    """Run both sites, the slave's as a service, with a hand that stays pressed onto the sample."""
    cable = WideAreaCable(0.002, 0.0)
    with closing(TwoSites(tmp_path, cable=cable)) as rig, closing(Service(rig.slave, tmp_path)) as service:
        rig.master.lean = True
        rig.master.start("--duration", "3600", "--set", CONSTANT_PUSH)
        rig.wait_until(rig.running, "a running session")
        service.follow_newest()
        rig.wait_until(lambda: modes(rig.slave)[-1:] == ["follow"], "a tip that follows")
        yield rig, cable, service


def modes(site: Site, since_ns: int = 0) -> list[str]:
    """Return the modes of the tip that a site has recorded since a time [ns]."""
    if not any(site.out.glob("session*.mcap")):
        return []
    return [str(message.fields()["mode"]) for message in site.recording().messages("afm/state", since_ns)]


def take_up(rig: TwoSites) -> None:
    """Arm the rig as a person does, until the tip follows."""
    rig.rearm()
    rig.wait_until(lambda: modes(rig.slave)[-1:] == ["follow"], "a tip that follows")


@pytest.mark.endurance("takes 2 min")
def test_a_launcher_that_is_killed_or_aborted_is_started_again_and_arms_nothing(
    supervised: tuple[TwoSites, WideAreaCable, Service],
) -> None:
    rig, _, service = supervised
    for count, number in enumerate((signal.SIGKILL, signal.SIGABRT), 1):
        launcher = psutil.Process(service.launchers()[-1])
        before, begin_ns = launcher.children(recursive=True), time.time_ns()
        assert len(before) >= 3
        os.kill(launcher.pid, number)
        _, alive = psutil.wait_procs(before, timeout=10.0)
        gone_s = (time.time_ns() - begin_ns) / NS_PER_S
        assert not alive, "nodes outlive their launcher"
        # It ended in order, which makes the device safe first.
        assert rig.slave.has_log("afm_node@slave", "stopped"), rig.slave.logs()
        rig.wait_until(lambda count=count: len(service.launchers()) == count + 1, "another launcher")
        rig.wait_until(lambda count=count: len(service.folders()) == count + 1, "another folder")
        service.follow_newest()
        rig.wait_until(lambda: bool(modes(rig.slave)), "a tip that reports again")
        back_s = (time.time_ns() - begin_ns) / NS_PER_S
        again_ns = time.time_ns()
        rig.wait_until(
            lambda since_ns=again_ns: bool(rig.master.recording().messages("teleop/backward@master", since_ns)),
            "the link",
        )
        time.sleep(3.0)
        assert set(modes(rig.slave)) <= {"retracted"}, "a rig that was started again moves without an arm"
        take_up(rig)
    assert service.deaths() == [-signal.SIGKILL, -signal.SIGABRT]
    record(
        "the launcher of a site that is a service is killed, and aborted",
        f"its nodes ended after {gone_s:.1f} s, the tip safe; at work again after {back_s:.0f} s, armed by hand",
    )


@pytest.mark.endurance("takes 5 min")
def test_a_cable_that_alters_bytes_behind_a_right_checksum_leaves_the_rig_to_be_armed(
    supervised: tuple[TwoSites, WideAreaCable, Service],
) -> None:
    rig, cable, service = supervised
    for rules in ({"flip_tcp": 0.03}, {"flip_tcp": 0.03, "loss": 0.02, "delay_s": 0.02}, {"flip_tcp": 0.3}) * 2:
        cable.change(**rules)
        for _ in range(4):
            time.sleep(6.0)
            cable.change(cut=True)
            time.sleep(0.5)
            cable.change(cut=False)
        counts = cable.change(flip_tcp=0.0, loss=0.0, delay_s=0.002)
        service.follow_newest()
        # Whatever befell it, the rig is there once the cable is sound, and a person takes it up.
        take_up(rig)
    assert rig.master.process is not None
    aborts = sum(path.read_text().count("killed by SIGABRT") for path in rig.folder.rglob("logs/launcher@*.log"))
    flipped = sum(ways.get("flipped", 0) for ways in counts["attacks"])
    assert flipped > 100
    machine.note(f"{flipped} packets altered: {aborts} nodes aborted, launchers of the slave ended {service.deaths()}")
    assert rig.master.process.poll() is None, rig.master.logs()
    record(
        "bytes of TCP between the sites are altered behind a right checksum",
        f"{flipped} packets altered, {aborts} nodes and {len(service.deaths())} launchers aborted; armed and going on",
    )
