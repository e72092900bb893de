"""What else may stand in the place of a file that a process opens while it runs: nothing of it may keep the process."""

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from odd_places import PLACES
from stopped_devices import HAND, MS, TIP, World

from telenano.console.lease import Lease
from telenano.console.lease_register import LeaseRegister
from telenano.files.atomic_files import locked
from telenano.launcher import processors
from telenano.runtime.bus.endpoint_lock import EndpointLock
from telenano.runtime.loop.commands import stop_of
from telenano.runtime.loop.kept_stop import keep, kept
from telenano.runtime.security.private_files import read_secret, read_trusted
from telenano.settings.link_traces import read_text
from telenano.wire import encode
from telenano.wire.errors import TelenanoError

# far beyond what it takes: only a call that waits for somebody else takes longer
PATIENCE_S = 20.0


def _lock_of(path: Path) -> None:
    with locked(path.with_suffix("")):
        pass


# What opens each file while a rig runs, and the name of the file.
OPENED: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "an emergency stop that is kept": ("afm_node@slave.estop.kept", kept),
    "the lease, looked at": ("lease", lambda path: LeaseRegister(path.parent).look()),
    "the lease, changed": ("lease", lambda path: LeaseRegister(path.parent).change(lambda lease, now_ns: lease)),
    "the lock of a shared file": ("lease.lock", _lock_of),
    "the lock of an endpoint": ("node.lock", lambda path: EndpointLock(f"ipc://{path.with_suffix('')}").release()),
    "the claim of a processor": ("telenano-processor-0.lock", processors._locked),
    "the turn at the processors": ("telenano-processors.lock", processors._locked),
    "a trace of the link": ("trace.txt", read_text),
    "who may open the page": ("people.json", read_secret),
    "the keys that are allowed": ("allowed.yaml", read_trusted),
}


def in_time(call: Callable[[], Any]) -> Any:
    """Return what a call gives or raises, which must not wait for anybody."""
    found: list[Any] = []

    def run() -> None:
        try:
            found.append(call())
        except (OSError, TelenanoError) as error:
            found.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert found, "the call waits"
    return found[0]


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("what", OPENED)
def test_nothing_that_stands_in_the_place_of_a_file_keeps_its_reader(
    what: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    tmp_path.chmod(0o700)
    name, read = OPENED[what]
    PLACES[kind](tmp_path / name)
    found = in_time(lambda: read(tmp_path / name))
    assert found is None or isinstance(found, OSError | TelenanoError | Lease | bytes | int | str)
    if isinstance(found, int):
        os.close(found)


@pytest.mark.parametrize("kind", [kind for kind in PLACES if kind != "file too large"])
def test_a_device_goes_on_beside_what_is_no_stop_and_says_so_once(kind: str, tmp_path: Path) -> None:
    here = World(tmp_path)
    path = here.devices[TIP].kept
    PLACES[kind](path)
    in_time(lambda: here.run(2000 * MS))
    told = [event for event in here.heard if str(path) in event.text]
    assert len(told) == 1
    assert here.modes() == {TIP: "retracted", HAND: "free"}
    if kind == "folder":
        return
    # whoever keeps a stop replaces what stands there
    assert keep(path, encode(stop_of(TIP, here.clock.now_ns()))) == ""
    here.run(1000 * MS)
    assert here.modes()[TIP] == "estop"


def test_a_stop_that_cannot_be_read_is_a_stop(tmp_path: Path) -> None:
    here = World(tmp_path)
    here.devices[TIP].kept.write_bytes(bytes(1 << 20))
    here.run(1000 * MS)
    assert here.modes()[TIP] == "estop"
