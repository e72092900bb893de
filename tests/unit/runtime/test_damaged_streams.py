"""What somebody on the path can do to the streams of TCP between two machines, with keys and without: no process ends.

libzmq has assertions that end a process (`Assertion failed: !_io_error`), so both ends are processes of their own.
"""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml
from damaging_cable import DamagingCable

from telenano.runtime.security.keyring import Keyring
from telenano.testing import free_ports

PEER = Path(__file__).parents[2] / "doubles" / "damaged_peer.py"
ENDS = {"master": ("delay_node@slave", "afm_node@slave"), "slave": ("afm_node@slave", "delay_node@slave")}


def book_of(ports: dict[str, int], *, insecure: bool) -> dict[str, Any]:
    nodes = {node: {"network": f"tcp://127.0.0.1:{port}"} for node, port in ports.items()}
    nodes["delay_node@slave"]["machine"] = "master"
    return {"nodes": nodes, "insecure": insecure}


def damage(
    folder: Path, seed: int, duration_s: float, *, insecure: bool
) -> tuple[dict[str, dict[str, Any]], Counter[str]]:
    """Run both ends with the cable between them; return what each says at its end, and what the cable did."""
    own = dict(zip(("delay_node@slave", "afm_node@slave"), free_ports(2), strict=True))
    beyond = dict(zip(own, free_ports(2), strict=True))
    rings = {machine: Keyring(folder / machine) for machine in ENDS}
    keys = {machine: ring.create(machine).public.decode() for machine, ring in rings.items()}
    rings["master"].allow("slave", keys["slave"], ["data"])
    rings["slave"].allow("master", keys["master"], ["data", "control"])
    peers = {}
    with DamagingCable({beyond[node]: own[node] for node in own}, seed) as cable:
        for machine, (binds, reads) in ENDS.items():
            # Each end binds its own port, and finds the other behind the cable.
            book = book_of({binds: own[binds], reads: beyond[reads]}, insecure=insecure)
            site_file = folder / f"{machine}.yaml"
            site_file.write_text(yaml.safe_dump(book))
            arguments = [str(site_file), machine, str(rings[machine].folder), binds, reads, str(duration_s)]
            peers[machine] = subprocess.Popen(
                [sys.executable, str(PEER), *arguments], env=os.environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                text=True,
            )  # fmt: skip
        found = {}
        for machine, peer in peers.items():
            out, err = peer.communicate(timeout=duration_s + 60.0)
            assert peer.returncode == 0, f"{machine}, seed {seed}: ended with {peer.returncode}: {err[-2000:]}"
            found[machine] = json.loads(out)
    return found, cable.done


def check(found: dict[str, dict[str, Any]], done: Counter[str]) -> None:
    assert sum(count for kind, count in done.items() if kind.startswith("flips")) > 0, done
    assert done["floods"] > 0, done
    for facts in found.values():
        assert facts["received"] > 0, (found, done)


@pytest.mark.check("takes 4 s")
def test_a_cable_that_damages_streams_ends_no_process(tmp_path: Path) -> None:
    check(*damage(tmp_path, 1, 3.0, insecure=False))


@pytest.mark.endurance("takes 5 min")
@pytest.mark.parametrize("insecure", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_longer_and_without_keys(tmp_path: Path, seed: int, insecure: bool) -> None:
    check(*damage(tmp_path, seed, 12.0, insecure=insecure))
