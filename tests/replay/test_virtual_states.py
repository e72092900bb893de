"""Declared states in re-runs: of samples of any size, and of code whose private names are others."""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, get_type_hints

import msgspec
import numpy as np
import pytest
from in_memory import InMemory
from numpy.typing import NDArray
from test_virtual_rig import edited

from services.afm_node import __main__ as afm
from services.controller import __main__ as controller
from services.controller import half
from services.delay_node import __main__ as delay
from services.haptic_node import __main__ as haptic
from telenano.afm.sample_models import register_sample
from telenano.afm.sim import SimulatedInstrument
from telenano.extend.samples import AfmSample, PlantInputs, SampleModel
from telenano.numerics.compiler import compiled
from telenano.recording.reader import RawMessage, Recording
from telenano.recording.rewrite import filter_recording
from telenano.rerun.rerun import rerun
from telenano.runtime.loop import journal
from telenano.sections.afm_section import AfmConfig
from telenano.virtual import LINK_NODE, NODES, VirtualRig, record_session
from telenano.wire.errors import RecordingError
from telenano.wire.node_state import pack, restore

ALL_NODES = (LINK_NODE, *NODES)


class LayerParams(NamedTuple):
    stiffness_n_per_m: float


class LayerState(NamedTuple):
    """Heights [m] of a layer that the tip presses down, and how often it has touched."""

    height_m: NDArray[np.float64]
    touched: int


def start(params: LayerParams, base_m: float) -> LayerState:
    return LayerState(np.linspace(0.0, 1e-9, 400_000), 0)


@compiled
def measure(params: LayerParams, state: LayerState, inputs: PlantInputs, dt: float) -> tuple[LayerState, AfmSample]:
    """The tip meets another place of the layer with each touch, and leaves a dent there."""
    place, touched = (7919 * state.touched) % len(state.height_m), state.touched
    depth = inputs.base_m + float(state.height_m[place])
    if depth > 0.0:
        state.height_m[place] -= 0.1 * depth
        touched += 1
    force = params.stiffness_n_per_m * max(depth, 0.0)
    sample = AfmSample(
        base_m=inputs.base_m,
        deflection_m=0.0,
        force_n=force,
        bridge_voltage_v=0.0,
        distance_m=-depth,
        distance_valid=True,
        in_contact=depth > 0.0,
        meniscus=False,
        lateral_x_n=0.0,
        lateral_y_n=0.0,
    )
    return LayerState(state.height_m, touched), sample


class _Config(AfmConfig):
    pass


register_sample(SampleModel("layer", _Config, LayerParams, start, measure, 1.0))


@pytest.fixture
def layer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the layer under the tip of every instrument that is built."""

    def driver(config: AfmConfig, period_s: float) -> SimulatedInstrument:
        return SimulatedInstrument(config.to_params()._replace(plant=LayerParams(1.0)))

    monkeypatch.setattr(afm, "driver_of", driver)
    # so that a short session has several states of 3 MB
    monkeypatch.setattr(journal, "_STATE_BYTES_PER_S", 2**25)


def pieces(recording: Recording) -> list[tuple[int, int, int]]:
    """Return seq, first turn and bytes of the state of each message of the instrument's journal."""
    found = ((m.seq, m.fields()) for m in recording.messages(["node/journal"]) if m.src == "afm_node@slave")
    return [(seq, fields["first_turn"], len(fields["state"]["data"])) for seq, fields in found]


@pytest.mark.check("takes 2.8 s")
@pytest.mark.usefixtures("layer")
def test_a_sample_with_a_large_state_is_run_again_from_the_middle(tmp_path: Path) -> None:
    path = record_session(tmp_path, 5)
    whole = InMemory(path)
    result = rerun(whole, "afm_node@slave")
    assert result.identical, result.verdict()
    assert (result.first_seq["afm/state"], result.left_out) == (0, 0)
    touched = [found.fields()["in_contact"] for found in whole.messages(["afm/state"])]
    assert sum(touched) > 300
    filter_recording(path, tmp_path / "late.mcap", start_s=0.6)
    late = rerun(InMemory(tmp_path / "late.mcap"), "afm_node@slave")
    assert late.identical, late.verdict()
    assert late.first_seq["afm/state"] > 400
    sizes: dict[int, list[int]] = {}
    for _, first_turn, size_bytes in pieces(whole):
        sizes.setdefault(first_turn, []).append(size_bytes)
    assert max(map(max, sizes.values())) <= 2**19
    assert sum(sum(found) > 3_000_000 for found in sizes.values()) > 1

    # a state that lacks a message is none, and the re-run begins with the next one
    third = pieces(whole)[2][0]

    def edit(message: RawMessage) -> bytes | None:
        lost = (message.channel.topic, message.channel.src, message.seq)
        return None if lost == ("node/journal", "afm_node@slave", third) else message.payload

    after = rerun(Recording(edited(whole, tmp_path, edit)), "afm_node@slave")
    assert after.identical, after.verdict()
    assert 400 < after.first_seq["afm/state"] < late.first_seq["afm/state"] + 600


@pytest.mark.check("takes 0.8 s")
@pytest.mark.usefixtures("layer")
def test_the_state_of_another_sample_is_refused_with_the_names_of_its_fields(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = InMemory(record_session(tmp_path, 5, duration_s=0.5))
    monkeypatch.undo()
    expected = r"afm_node@slave: its state in the journal does not fit this code: it lacks .*part.distance_m.* and has"
    with pytest.raises(RecordingError, match=f"{expected} in addition part.height_m, part.touched"):
        rerun(recording, "afm_node@slave")


def renamed(module: ModuleType) -> ModuleType:
    """Return the module of a node with other names for itself, its classes, and the private attributes that it sets."""
    source = Path(str(module.__file__)).read_text(encoding="utf-8")
    found = list(ast.walk(ast.parse(source)))
    classes = {node.name for node in found if isinstance(node, ast.ClassDef)}
    stored = {node.attr for node in found if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)}
    # what a class in another module uses as well keeps its name
    private = {name for name in stored if name.startswith("_") and f"self.{name}" not in HALF}
    assert classes
    for name in classes:
        source = re.sub(rf"\b{name}\b", f"Other{name}", source)
    for name in private:
        source = re.sub(rf"\bself\.{name}\b", f"self._other{name}", source)
    made = ModuleType(f"other_{module.__name__.replace('.', '_')}")
    sys.modules[made.__name__] = made
    exec(compile(source, made.__name__, "exec"), made.__dict__)
    return made


HALF = Path(str(half.__file__)).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def rig() -> Iterator[VirtualRig]:
    """A rig in the middle of a session, with jitter and a queue on the link."""
    link = '{"jitter": {"scale_s": 0.002}, "rate": {"rate_bytes_per_s": 500000.0}}'
    made = VirtualRig(None, 3, [f"delay_node.forward={link}", "controller.law=smith"])
    made.run_until(0.15)
    made.command("arm", "*", place="hand")
    made.run_until(0.3)
    made.command("start", "haptic_node")
    made.command("set", "controller", **{"smith.force_gain": 8.0})
    made.run_until(0.8)
    yield made
    made.close()


@pytest.mark.parametrize("key", ALL_NODES)
def test_a_node_with_other_private_names_classes_and_modules_takes_the_state(
    rig: VirtualRig, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node: Any = rig.loops[key].node
    module = renamed(sys.modules[type(node).__module__])
    monkeypatch.setattr(afm, "AfmNode", getattr(module, "OtherAfmNode", None))
    monkeypatch.setattr(haptic, "HapticNode", getattr(module, "OtherHapticNode", None))
    monkeypatch.setattr(delay, "DelayNode", getattr(module, "OtherDelayNode", None))
    half = getattr(module, f"Other{type(node).__name__}")
    monkeypatch.setattr(controller, "half_of_site", half)
    other: Any = rig.build(key, node.context)
    assert type(other).__name__ == f"Other{type(node).__name__}"
    fresh = pack(other)
    restore(other, pack(node), rig_payload(rig))
    assert pack(other) == pack(node) != fresh


@pytest.mark.parametrize("key", ALL_NODES)
def test_a_field_that_is_added_to_the_state_of_a_node_is_kept(
    rig: VirtualRig, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The field stands nowhere but in the state: no line says that it is captured or restored."""
    node: Any = rig.loops[key].node
    other: Any = rig.build(key, node.context)
    kind = whole = type(node).state_kind
    name = "_memory" if hasattr(node, "_memory") else "memory"
    memory = getattr(node, name)
    further = msgspec.defstruct("Further", [("further", int, 0)], bases=(type(memory),), kw_only=True)
    if kind is not type(memory):
        # The state of a device is what its node remembers, and that of its parts.
        hints = get_type_hints(kind) | {"memory": further}
        whole = NamedTuple(kind.__name__, hints.items())  # type: ignore[misc]
        monkeypatch.setattr(sys.modules[type(node).__module__], kind.__name__, whole)
    monkeypatch.setattr(type(node), "state_kind", further if whole is kind else whole)
    monkeypatch.setattr(node, name, further(**msgspec.structs.asdict(memory), further=7))
    restore(other, pack(node), rig_payload(rig))
    assert getattr(other, name).further == 7
    assert pack(other) == pack(node)


def rig_payload(rig: VirtualRig) -> Callable[[str, str, int, int, int], bytes]:
    sent = {(m.src, m.seq, len(payload)): payload for payload, m in rig.messages.items()}
    return lambda topic, src, seq, arrived_ns, size_bytes: sent[src, seq, size_bytes]


def texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from (text for pair in value.items() for part in pair for text in texts(part))
    elif isinstance(value, list):
        yield from (text for part in value for text in texts(part))


@pytest.mark.parametrize("key", ALL_NODES)
def test_a_state_holds_no_name_of_a_private_attribute_a_class_or_a_module(rig: VirtualRig, key: str) -> None:
    node = rig.loops[key].node
    found = set(texts(msgspec.msgpack.decode(pack(node), strict=False)))
    assert len(found) > 10
    assert {name for text in found for name in text.split(".") if name.startswith("_")} == set()
    assert not {text for text in found if text.startswith(("services.", "telenano"))}
    classes = {type(node).__name__, type(node).__qualname__, type(node).state_kind.__name__, "SafetyState", "Fate"}
    assert not found & classes
