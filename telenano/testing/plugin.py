"""The fixtures of the kit, which pytest finds by the entry point of the wheel.

Every pytest on a machine with telenano imports this module, so it imports other modules only when a fixture is used.
"""

import hashlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from telenano.testing.bench import NodeBench
    from telenano.testing.processes import LiveRig
    from telenano.virtual import VirtualRig


@pytest.fixture
def bench_of() -> "type[NodeBench]":
    """Return the class of benches of one node in virtual time; call it with node@site."""
    from telenano.testing.bench import NodeBench

    return NodeBench


@pytest.fixture
def virtual_rig(tmp_path: Path) -> "Iterator[Callable[..., VirtualRig]]":
    """Return a function that makes a rig of both sites in virtual time; the rig is closed after the test.

    The arguments are settings in the form of `--set`, and `seed`, `scenario` and `timing` of `VirtualRig`. Each
    recording has its own folder. With `running=True` both devices are armed, and the programme of the hand has begun,
    0.3 s after the nodes.
    """
    from telenano.virtual import ARMED_S, STARTED_S, VirtualRig

    rigs: list[VirtualRig] = []

    def made(*settings: str, seed: int = 1, running: bool = False, **given: Any) -> VirtualRig:
        rig = VirtualRig(tmp_path / f"virtual_rig_{len(rigs)}", seed, settings, **given)
        rigs.append(rig)
        if running:
            rig.run_until(ARMED_S)
            rig.command("arm", "*", place="hand")
            rig.run_until(STARTED_S)
            rig.command("start", "haptic_node")
        return rig

    yield made
    for rig in rigs:
        rig.close()


@pytest.fixture
def live_rig(tmp_path: Path) -> "Iterator[LiveRig]":
    """Return a rig of real processes that is not started yet; it is ended after the test, even if that fails."""
    from telenano.testing.processes import LiveRig

    rig = LiveRig(tmp_path)
    yield rig
    rig.close()


@pytest.fixture(scope="session")
def recordings_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the recordings that all tests of a run share."""
    base = tmp_path_factory.getbasetemp()
    # The workers of a run have separate folders in a common one.
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "recorded"


@pytest.fixture(scope="session")
def recording_of(recordings_folder: Path) -> Callable[..., Path]:
    """Return a function that records the beginning of Fig. 12 in virtual time, as `record_fig12`, once for all tests.

    Its arguments are a law and settings in the form of `--set`. All tests share the file: copy it before changing it.
    """
    from telenano.testing.recordings import record_fig12, recording_with

    def recorded(law: str = "virtual_impedance", *settings: str, **given: Any) -> Path:
        def make(folder: Path) -> Path:
            return record_fig12(folder, law, settings, **given)

        words = [*settings, *(f"{key}={value}" for key, value in sorted(given.items()))]
        name = f"fig12_{law}" + (f"_{hashlib.sha256(repr(words).encode()).hexdigest()[:16]}" if words else "")
        return recording_with(recordings_folder, name, make)

    return recorded


@pytest.fixture
def plain_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the closed loop of studies as plain Python, with the same bits: a short run is faster than compiling."""
    monkeypatch.setattr("telenano.lockstep.lockstep.compiled_call", lambda step, given: step(*given))
    monkeypatch.setattr("telenano.lockstep.lockstep.is_compiled", lambda step, given: False)


@pytest.fixture
def without_realtime(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prevent commands in this process from requesting real-time scheduling, which would outlast the test."""
    monkeypatch.setattr("telenano.runtime.loop.realtime.apply_realtime", lambda *settings: None)


@pytest.fixture
def networks_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a folder for network profiles that this test can use by name, set as TELENANO_NETWORKS."""
    from telenano.settings import network_profiles

    def forget() -> None:
        network_profiles._names.cache_clear()
        network_profiles._read.cache_clear()

    monkeypatch.setenv("TELENANO_NETWORKS", str(tmp_path))
    forget()
    yield tmp_path
    forget()
