"""The code gives what it gave when the reference recordings were made, and the same bits on every processor."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
from in_memory import InMemory
from references import (
    COMPILED,
    LINK_REFERENCE,
    OUTPUTS,
    REFERENCES,
    SHARE,
    SHORT_S,
    MachineTolerances,
    nodes_of,
    rerun_digests,
)

import proto.codec
from analysis.process_replay import ReplayBus, RerunResult, rerun
from proto import TOPICS, Message
from proto.errors import ConfigError, RecordingError
from proto.messages import AfmState
from proto.typed import typed_form
from recording.channel_filter import Selection
from recording.reader import Recording
from recording.rewrite import filter_recording
from recording.tolerance import Tolerances
from services.controller.config import LAWS
from services.controller.laws.virtual_impedance import VirtualImpedanceConfig

REFERENCE = Path(__file__).parent / "virtual_impedance.mcap"


JOURNALLED = all("node/journal" in {found.topic for found in Recording(path).channels} for path in REFERENCES)
CASES = [(path, node) for path in REFERENCES for node in nodes_of(path)]
needs_journal = pytest.mark.skipif(not JOURNALLED, reason="the references have no journal: make them anew")


Rerun = tuple[Recording, RerunResult, list[str]]


@pytest.fixture(scope="module")
def reference() -> Recording:
    return InMemory(REFERENCE)


@pytest.fixture(scope="module")
def reruns() -> Callable[[Path, str], Rerun]:
    """The re-run of each reference and each of its nodes, once."""
    recordings: dict[Path, Recording] = {}
    made: dict[tuple[Path, str], Rerun] = {}

    def rerun_once(path: Path, node: str) -> Rerun:
        if (path, node) not in made:
            recording = recordings.get(path) or recordings.setdefault(path, InMemory(path))
            made[path, node] = (recording, *rerun_digests(recording, node))
        return made[path, node]

    return rerun_once


def test_there_is_a_reference_with_a_journal_for_each_law_and_for_the_link() -> None:
    assert {path.stem for path in REFERENCES} == {*LAWS, LINK_REFERENCE.stem}
    assert all(path.stat().st_size < 1_100_000 for path in REFERENCES)
    assert JOURNALLED, "recorded before nodes kept a journal: run python tests/replay/make_references.py"


@needs_journal
@pytest.mark.parametrize(("path", "node"), CASES, ids=lambda case: case.stem if isinstance(case, Path) else case)
def test_a_rerun_says_what_was_recorded(reruns: Callable[[Path, str], Rerun], path: Path, node: str) -> None:
    recording, result, _ = reruns(path, node)
    assert result.difference == ""
    assert result.ended_early == ""
    assert result.identical
    # nothing was left out: every recorded message of the node's outputs was met
    assert set(result.compared) >= set(OUTPUTS[node])
    for topic in OUTPUTS[node]:
        seqs = [message.seq for message in recording.messages([topic]) if message.src == node]
        expected = len([seq for seq in seqs if seq >= result.first_seq[topic]])
        assert result.compared[topic] == expected > LEAST.get(topic, 1000)
        # a batch of the journal covers half a second, and the first may be one whose beginning was not recorded
        assert result.first_seq[topic] - seqs[0] < 1100


# of the others there are a thousand in a second
LEAST = {"law/status": 100, "link/status": 10, "link/fates": 100}


@needs_journal
def test_the_reference_of_the_link_shows_what_a_link_can_do(reruns: Callable[[Path, str], Rerun]) -> None:
    recording, result, _ = reruns(LINK_REFERENCE, "delay_node@master")
    fates = [fate for message in recording.messages(["link/fates"]) for fate in message.fields()["fates"]]
    assert {fate["dropped"] for fate in fates} >= {"", "loss", "gilbert_elliott"}
    for what in ("is_duplicate", "reordered", "corrupted", "queue_ns"):
        assert any(fate[what] for fate in fates), what
    assert len({fate["delay_ns"] for fate in fates}) > 1000
    assert min(result.compared[topic] for topic in ("teleop/forward@slave", "teleop/backward@master")) > 800


def test_the_tolerance_is_a_billionth_of_what_a_field_reaches(reference: Recording) -> None:
    allowed = MachineTolerances(reference, "controller@master")
    assert 0.0 < allowed.on("teleop/forward").of("position_m") < 1e-7 * SHARE
    assert 1e-3 * SHARE < allowed.on("haptic/command").of("position_m.2") < 1.0 * SHARE


# What chooses a BLAS kernel, what takes instructions from NumPy and from the C library, and every step compiled.
ELSEWHERE = {
    "haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "skylakex": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "zen": {"OPENBLAS_CORETYPE": "Zen"},
    "compiled": {COMPILED: "1"},
    "numpy_baseline": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"},
    "without_fma": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-FMA_Usable,-FMA4_Usable,-AVX2_Usable"},
}


@needs_journal
@pytest.mark.parametrize("kind", ELSEWHERE)
def test_another_processor_gives_the_same(reruns: Callable[[Path, str], Rerun], kind: str) -> None:
    command = [sys.executable, str(Path(__file__).with_name("references.py"))]
    done = subprocess.run(command, env={**os.environ, **ELSEWHERE[kind]}, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    here = {f"{path.stem} {node}": reruns(path, node)[2] for path, node in CASES}
    assert set(found) == set(here)
    assert {name: fault for name, (fault, _, _) in found.items() if fault} == {}
    assert min(count for _, count, _ in found.values()) > 100
    # they are the beginnings of what was re-run here
    differing = {name for name, (_, count, digest) in found.items() if digest != here[name][count - 1]}
    if kind == "without_fma":
        # motor, tip and the random delays of the link call the C library, the laws do not
        differing = {name for name in differing if "controller" in name}
    assert differing == set()


@needs_journal
def test_a_changed_gain_is_reported_with_message_field_and_time(reference: Recording) -> None:
    changed = 1.05 * VirtualImpedanceConfig().force_gain
    result = rerun(reference, "controller@master", settings=[f"controller.virtual_impedance.force_gain={changed}"])
    assert not result.identical
    assert result.topic == "haptic/command"
    assert result.field == "position_m.2"
    assert 0.0 < result.time_s < 10.0
    assert f"haptic/command, seq {result.seq}, {result.time_s:.6f} s after the start: re-run position_m.2" in (
        result.difference
    )
    assert result.compared["haptic/command"] > 100


@needs_journal
def test_a_changed_gain_within_the_tolerance_is_the_same(reference: Recording) -> None:
    gain = VirtualImpedanceConfig().force_gain * (1.0 + 1e-10)
    barely = [f"controller.virtual_impedance.force_gain={gain!r}"]
    assert not rerun(reference, "controller@master", settings=barely).identical
    allowed = Tolerances({"position_m": 1e-9, "velocity_m_per_s": 1e-6, "force_n": 0.0, "law/status:*": 1e-9})
    assert rerun(reference, "controller@master", allowed, barely).identical


@needs_journal
def test_another_sample_is_reported_at_the_instrument(reference: Recording) -> None:
    result = rerun(reference, "afm_node@slave", settings=["afm_node.rest_distance_m=1.0001e-8"])
    assert result.topic == "afm/state"
    assert result.field in ("deflection_m", "tip_force_n.2", "separation_m")


@needs_journal
def test_a_lost_input_ends_the_comparison_with_its_name(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    filter_recording(REFERENCE, cut, Selection.of(exclude=["afm/command"]))
    with pytest.raises(RecordingError, match="with all inputs: lacks afm/command, seq"):
        rerun(Recording(cut), "afm_node@slave")
    filter_recording(REFERENCE, tmp_path / "late.mcap", start_s=Recording(REFERENCE).info().duration_s - 1.0)
    late = rerun(Recording(tmp_path / "late.mcap"), "controller@master")
    assert min(late.first_seq.values()) > 0


@needs_journal
def test_what_cannot_be_rerun_is_named(reference: Recording, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="recorder@master: cannot be run again: the recording is what it makes"):
        rerun(reference, "recorder@master")
    with pytest.raises(ConfigError, match="force_gan: unknown key"):
        rerun(reference, "controller@master", settings=["controller.virtual_impedance.force_gan=1.0"])


class WarmerState(AfmState):
    """The state of an instrument that has learned to say how warm it is."""

    version: ClassVar[int] = 3
    additions: ClassVar[Mapping[str, int]] = {**AfmState.additions, "temperature_k": 3}
    temperature_k: float | None = None


@pytest.fixture(scope="module")
def beginning() -> InMemory:
    return InMemory(REFERENCE, SHORT_S)


@pytest.fixture
def say_more(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Let the instrument say fields besides its own, or without those named, as a message of a newer class."""

    def say(without: tuple[str, ...] = (), **more: Any) -> None:
        row = replace(TOPICS["afm/state"], model=WarmerState)
        form = proto.codec._form_of(row)
        monkeypatch.setitem(TOPICS, "afm/state", row)
        monkeypatch.setitem(proto.codec._FORMS, "afm/state", form)
        monkeypatch.setitem(proto.codec._TYPED, "afm/state", typed_form(WarmerState, form.most_bytes))
        monkeypatch.setitem(proto.codec._MOST_BYTES, WarmerState, form.most_bytes)
        publish_as = ReplayBus.publish_as

        def publish_more(bus: ReplayBus, src: str, topic: str, fields: Mapping[str, Any]) -> Message:
            said = {**fields, **more} if topic == "afm/state" else fields
            return publish_as(bus, src, topic, {key: value for key, value in said.items() if key not in without})

        monkeypatch.setattr(ReplayBus, "publish_as", publish_more)

    return say


@needs_journal
def test_an_optional_key_added_since_leaves_an_older_recording_equal(
    beginning: InMemory, say_more: Callable[..., None]
) -> None:
    before = rerun(beginning, "afm_node@slave", MachineTolerances(beginning, "afm_node@slave"))
    say_more(temperature_k=293.0)
    said: list[Message] = []
    tolerances = MachineTolerances(beginning, "afm_node@slave")
    result = rerun(beginning, "afm_node@slave", tolerances, take=lambda topic, message: said.append(message))
    states = [message for message in said if isinstance(message, WarmerState)]
    assert {(state.v, state.temperature_k) for state in states} == {(3, 293.0)}
    assert len(states) == result.compared["afm/state"] > 200
    assert result.difference == ""
    assert result.identical
    assert result == before


@needs_journal
@pytest.mark.parametrize(("field", "value"), [("mode", "estop"), ("meniscus", True), ("step_s", 2e-3)])
def test_a_changed_value_beside_an_added_key_is_a_difference(
    beginning: InMemory, say_more: Callable[..., None], field: str, value: Any
) -> None:
    say_more(temperature_k=293.0, **{field: value})
    result = rerun(beginning, "afm_node@slave", MachineTolerances(beginning, "afm_node@slave"))
    assert not result.identical
    assert (result.topic, result.field) == ("afm/state", field)


@needs_journal
@pytest.mark.parametrize(
    ("recorded", "without", "field"),
    [
        # a recorded key that is missing now, beside a higher version, the same one and a lower one
        ({"device": "ok", "v": 2}, (), "device"),
        ({"device": "ok", "v": 1}, ("temperature_k",), "device"),
        ({"device": "ok", "v": 2}, ("temperature_k",), "v"),
        ({"temperature_k": 292.0, "v": 3}, (), "temperature_k"),
        ({"v": 2}, ("temperature_k",), "v"),
    ],
)
def test_a_recorded_optional_key_that_is_missing_or_differs_is_a_difference(
    beginning: InMemory, say_more: Callable[..., None], recorded: dict[str, Any], without: tuple[str, ...], field: str
) -> None:
    say_more(without, temperature_k=293.0)
    edited = beginning.edited("afm/state", recorded)
    result = rerun(edited, "afm_node@slave", MachineTolerances(edited, "afm_node@slave"))
    assert not result.identical
    assert (result.topic, result.field) == ("afm/state", field)
