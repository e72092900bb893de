"""What somebody on the path can do to the streams of TCP between two machines, with keys and without: no process ends.

libzmq has assertions that end a process (`Assertion failed: !_io_error`), so both ends are processes of their own.
"""

import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml
from damaging_cable import DamagingCable

from telenano.runtime.security.keyring import Keyring
from telenano.testing import free_ports

PEER = Path(__file__).parents[2] / "doubles" / "damaged_peer.py"
# far beyond what is expected
PATIENCE_S = 150.0
ENDS = {"master": ("delay_node@slave", "afm_node@slave"), "slave": ("afm_node@slave", "delay_node@slave")}


def book_of(ports: dict[str, int], *, insecure: bool) -> dict[str, Any]:
    nodes = {node: {"network": f"tcp://127.0.0.1:{port}"} for node, port in ports.items()}
    nodes["delay_node@slave"]["machine"] = "master"
    return {"nodes": nodes, "insecure": insecure}


def altered(done: Counter[str]) -> int:
    """Return how often the cable has altered what passed it."""
    return sum(count for kind, count in done.items() if " in " in kind)


def damage(folder: Path, seed: int, times: int, *, insecure: bool) -> None:
    """Run both ends with the cable between them until it has altered something so often, and both were heard."""
    own = dict(zip(("delay_node@slave", "afm_node@slave"), free_ports(2), strict=True))
    beyond = dict(zip(own, free_ports(2), strict=True))
    rings = {machine: Keyring(folder / machine) for machine in ENDS}
    keys = {machine: ring.create(machine).public.decode() for machine, ring in rings.items()}
    rings["master"].allow("slave", keys["slave"], ["data"])
    rings["slave"].allow("master", keys["master"], ["data", "control"])
    peers, heard = {}, [folder / f"heard-{machine}" for machine in ENDS]
    with DamagingCable({beyond[node]: own[node] for node in own}, seed) as cable:
        for machine, (binds, reads) in ENDS.items():
            # Each end binds its own port, and finds the other behind the cable.
            book = book_of({binds: own[binds], reads: beyond[reads]}, insecure=insecure)
            site_file = folder / f"{machine}.yaml"
            site_file.write_text(yaml.safe_dump(book))
            arguments = [site_file, machine, rings[machine].folder, binds, reads, folder / f"heard-{machine}"]
            peers[machine] = subprocess.Popen(
                [sys.executable, str(PEER), *map(str, arguments)], env=os.environ, stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
        end_s = time.monotonic() + PATIENCE_S
        while altered(cable.done) < times or not all(path.exists() for path in heard):
            assert time.monotonic() < end_s, cable.done
            if any(peer.poll() is not None for peer in peers.values()):
                break
            time.sleep(0.05)
        for machine, peer in peers.items():
            _, err = peer.communicate(timeout=60.0)
            assert peer.returncode == 0, f"{machine}, seed {seed}: ended with {peer.returncode}: {err[-2000:]}"
    assert cable.done["floods"] > 0


@pytest.mark.check("takes 5 s")
def test_a_cable_that_damages_streams_ends_no_process(tmp_path: Path) -> None:
    damage(tmp_path, 1, 8, insecure=False)


@pytest.mark.endurance("takes 5 min")
@pytest.mark.parametrize("insecure", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_longer_and_without_keys(tmp_path: Path, seed: int, insecure: bool) -> None:
    damage(tmp_path, seed, 30, insecure=insecure)
