"""The code gives what it gave when the digests of the references were written, and the same bits on every processor."""

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
from make_references import make, shortened
from references import (
    COMPILED,
    DIGESTS,
    REFERENCED,
    REFERENCES,
    RERUN,
    SHARE,
    Digests,
    Field,
    MachineTolerances,
    additions,
    c_library,
    differences,
    digests_of,
    field_of,
    read_digests,
    write_digests,
)

import telenano.wire.codec
from telenano.recording.field_differences import Tolerances
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.rerun.rerun_bus import RerunBus
from telenano.sections import VirtualImpedanceConfig
from telenano.wire import Message
from telenano.wire.errors import ConfigError
from telenano.wire.messages import AfmState
from telenano.wire.nodes import RERUN_NODES
from telenano.wire.topics import TOPICS

# shows all that the instrument does
SHORT_S = 1.3


@pytest.fixture(scope="module")
def path(reference_of: Callable[[str], Path]) -> Path:
    return reference_of("virtual_impedance")


@pytest.fixture(scope="module")
def reference(path: Path) -> InMemory:
    return InMemory(path)


def test_there_is_a_reference_for_each_law_and_for_the_link() -> None:
    _, kept = read_digests()
    assert set(kept) == set(REFERENCES) == {*REFERENCED, "link"}
    assert {REFERENCES[law].law for law in REFERENCED} == set(REFERENCED)
    for name, channels in kept.items():
        assert {channel.split()[0] for channel in channels} > set(RERUN), name
        assert sum(field.count for field in channels["afm_node@slave afm/state"].values()) > 10_000


@pytest.mark.parametrize("name", REFERENCES)
def test_a_reference_gives_the_digests_that_were_written(reference_of: Callable[[str], Path], name: str) -> None:
    library, kept = read_digests()
    found = digests_of(Recording(reference_of(name)))
    changed = differences(kept[name], found, same_bits=library == c_library())
    assert shortened(changed) == ["nothing changed"], WHAT_TO_DO


HAND = "haptic_node@master haptic/state"
WHAT_TO_DO = (
    "was it meant? then run python tests/replay/make_references.py. A longer message alone moves what a link of a"
    " limited rate carries: a field of node/health that tells of the machine belongs into Machine.health"
    " (telenano/virtual/README.md), where virtual time leaves it out"
)


def edited(kept: Digests, field: str, values: list[Any] | None) -> Digests:
    """Return digests in which a field of the hand has other values, or none."""
    others = {name: found for name, found in kept[HAND].items() if name != field}
    return {**kept, HAND: others if values is None else others | {field: field_of(values)}}


def test_each_kind_of_change_is_told() -> None:
    values = [1e-9 * n for n in range(100)]
    kept = edited(read_digests()[1]["wave"], "force_n.0", values)
    by_bits = {same: differences(kept, kept, same_bits=same) for same in (True, False)}
    assert by_bits == {True: [], False: []}
    # the last bit of one value: only another C library excuses it
    last = [*values[:-1], values[-1] * (1.0 + 2**-52)]
    (text,) = differences(kept, edited(kept, "force_n.0", last), same_bits=True)
    assert text.startswith(f"{HAND}: force_n.0 ")
    assert differences(kept, edited(kept, "force_n.0", last), same_bits=False) == []
    for same_bits in (True, False):
        for other, told in (
            ([1.00001 * value for value in values], "force_n.0 mean 4.95"),
            (values[:-1], "force_n.0 has 99 values, 100 before"),
            (None, "force_n.0 is not said any more"),
        ):
            (text,) = differences(kept, edited(kept, "force_n.0", other), same_bits=same_bits)
            assert text.startswith(f"{HAND}: {told}")
        (text,) = differences(kept, edited(kept, "mode", ["off"] * kept[HAND]["mode"].count), same_bits=same_bits)
        assert text == f"{HAND}: mode has other values"
        fewer = {channel: fields for channel, fields in kept.items() if channel != HAND}
        assert differences(kept, fewer, same_bits=same_bits) == [f"{HAND}: says nothing any more"]
    # an order is a change of bits, and no optional key that was added is one
    assert differences(kept, edited(kept, "force_n.0", values[::-1]), same_bits=True) == [
        f"{HAND}: force_n.0 has other values"
    ]
    more = edited(kept, "grip_n", values)
    assert differences(kept, more, same_bits=True) == []
    assert additions(kept, more) == [f"{HAND}: grip_n is new"]


@pytest.mark.check("takes 1.9 s")
@pytest.mark.drawn(0.0, "tests/replay/", "telenano/rerun/")
def test_the_digests_are_renewed_with_one_command_that_says_what_changed(tmp_path: Path) -> None:
    path = tmp_path / "digests.json"
    # A field that a message has besides is in no digest until they are renewed.
    write_digests(read_digests()[1], path)
    make(["wave"], path)
    renewed = path.read_bytes()
    _, kept = read_digests(path)
    write_digests({**kept, "wave": edited(kept["wave"], "force_n.0", [0.5]), "gone": {}}, path)
    (text, gone) = make(["wave"], path)
    assert text.startswith(f"wave: {HAND}: force_n.0 is not said any more")
    assert gone == "gone: is not a reference any more"
    assert path.read_bytes() == renewed
    assert make(["wave"], path) == []


def test_a_long_list_of_changes_is_shortened() -> None:
    told = [f"wave: {HAND}: force_n.{n} is new" for n in range(9)]
    assert shortened(told) == [*told[:4], f"wave: {HAND}: 5 other fields as well"]
    assert shortened([]) == ["nothing changed"]


def test_whole_numbers_are_taken_from_their_first_on() -> None:
    stamps = field_of([1_750_000_000_000_000_000 + n for n in range(3)])
    assert (stamps.mean, stamps.rms) == (1.0, (5.0 / 3.0) ** 0.5)
    assert field_of([None, "off"]) == Field(2, field_of([None, "off"]).digest, 0.0, 0.0)


def test_the_tolerance_is_a_billionth_of_what_a_field_reaches(reference: Recording) -> None:
    allowed = MachineTolerances(reference, "controller@master")
    assert 0.0 < allowed.on("teleop/forward").of("position_m") < 1e-7 * SHARE
    assert 1e-3 * SHARE < allowed.on("haptic/command").of("position_m.2") < 1.0 * SHARE


# Three choices of a BLAS kernel, and with each another thing that may not matter: NumPy without newer instructions,
# every step compiled, the C library without newer instructions.
ELSEWHERE = {
    "haswell_and_numpy_baseline": {
        "OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"
    },
    "skylakex_and_compiled": {"OPENBLAS_CORETYPE": "SkylakeX", COMPILED: "1"},
    "zen_without_fma": {
        "OPENBLAS_CORETYPE": "Zen",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-FMA_Usable,-FMA4_Usable,-AVX2_Usable",
    },
}  # fmt: skip


@pytest.mark.check("takes 12 s")
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[] if kind == "haswell_and_numpy_baseline" else [pytest.mark.endurance])
        for kind in ELSEWHERE
    ],
)
def test_another_processor_gives_the_same(reference_of: Callable[[str], Path], kind: str) -> None:
    """Each node there says what it said here, given the same: so do all of them together."""
    folder = {reference_of(name).parents[1] for name in REFERENCES}.pop()
    command = [sys.executable, str(DIGESTS.with_name("references.py")), str(folder)]
    done = subprocess.run(command, env={**os.environ, **ELSEWHERE[kind]}, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    reruns = found["reruns"]
    assert set(reruns) == {f"{name} {node}" for name in REFERENCES for node in RERUN}
    assert min(compared for compared, _, _ in reruns.values()) > 1000
    assert {name: beyond for name, (_, _, beyond) in reruns.items() if beyond} == {}
    differing = {name: bits for name, (_, bits, _) in reruns.items() if bits}
    if found["c_library"] != c_library():
        # motor, tip and the random delays of the link call it, the laws do not
        differing = {name: bits for name, bits in differing.items() if "controller" in name}
    assert differing == {}
    assert (found["c_library"] == c_library()) or kind == "zen_without_fma"


def test_a_changed_gain_within_the_tolerance_is_the_same(reference: Recording) -> None:
    gain = VirtualImpedanceConfig().force_gain * (1.0 + 1e-10)
    barely = [f"controller.virtual_impedance.force_gain={gain!r}"]
    assert not rerun(reference, "controller@master", settings=barely).identical
    # At a limit of the hand the force that a law is given follows from its parameters.
    forces = {"force_n": 0.0, "teleop/forward:force_n": 1e-14}
    allowed = Tolerances({"position_m": 1e-9, "velocity_m_per_s": 1e-6, **forces, "law/status:*": 1e-9})
    assert rerun(reference, "controller@master", allowed, barely).identical


def test_a_rerun_covers_a_source_until_its_recording_ends(reference: InMemory) -> None:
    # As in a joined recording, in which the recorder of the other site ended first.
    result = rerun(reference.without("afm/state", 0.7, 1e6), "controller@slave")
    assert result.identical, result.verdict()
    assert result.left_out > 0
    assert 0 < result.compared["afm/command"] < rerun(reference, "controller@slave").compared["afm/command"]


def test_a_rerun_ends_early_at_a_hole_in_a_source(reference: InMemory) -> None:
    result = rerun(reference.without("afm/state", 0.7, 0.75), "controller@slave")
    assert not result.identical
    assert "the recording lacks afm/state, seq" in result.ended_early


def test_what_cannot_be_rerun_is_named(reference: Recording, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="recorder@master: cannot be run again: the recording is what it makes"):
        rerun(reference, "recorder@master")
    with pytest.raises(ConfigError, match="force_gan: unknown key"):
        rerun(reference, "controller@master", settings=["controller.virtual_impedance.force_gan=1.0"])


def test_only_the_link_needs_the_site_file_of_a_recording(path: Path) -> None:
    # As a file of an older version may be, whose keys have other names today.
    older = InMemory(path, SHORT_S).attaching("site.yaml", b"endpoints: {}\n")
    for node in set(RERUN_NODES) - {"delay_node@master"}:
        result = rerun(older, node)
        assert result.identical, f"{node}: {result.verdict()}"
    with pytest.raises(ConfigError, match=r"site\.yaml in .*: endpoints: unknown key"):
        rerun(older, "delay_node@master")


class WarmerState(AfmState):
    """The state of an instrument that has learned to say how warm it is."""

    version: ClassVar[int] = 2
    temperature_k: float | None = None


@pytest.fixture(scope="module")
def beginning(path: Path) -> InMemory:
    return InMemory(path, SHORT_S)


@pytest.fixture
def say_more(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Let the instrument say fields besides its own, or without those named, as a message of a newer class."""

    def say(without: tuple[str, ...] = (), **more: Any) -> None:
        row = replace(TOPICS["afm/state"], model=WarmerState)
        form = telenano.wire.codec._form_of(row)
        monkeypatch.setitem(TOPICS, "afm/state", row)
        monkeypatch.setitem(telenano.wire.codec._FORMS, "afm/state", form)
        monkeypatch.setitem(telenano.wire.codec.MOST_BYTES, WarmerState, form.most_bytes)
        publish_as = RerunBus.publish_as

        def publish_more(bus: RerunBus, src: str, topic: str, fields: Mapping[str, Any]) -> Message:
            said = {**fields, **more} if topic == "afm/state" else fields
            return publish_as(bus, src, topic, {key: value for key, value in said.items() if key not in without})

        monkeypatch.setattr(RerunBus, "publish_as", publish_more)

    return say


def test_an_optional_key_added_since_leaves_an_older_recording_equal(
    beginning: InMemory, say_more: Callable[..., None]
) -> None:
    before = rerun(beginning, "afm_node@slave", MachineTolerances(beginning, "afm_node@slave"))
    say_more(temperature_k=293.0)
    said: list[Message] = []
    tolerances = MachineTolerances(beginning, "afm_node@slave")
    result = rerun(beginning, "afm_node@slave", tolerances, take=lambda topic, message: said.append(message))
    states = [message for message in said if isinstance(message, WarmerState)]
    assert {(state.v, state.temperature_k) for state in states} == {(2, 293.0)}
    assert len(states) == result.compared["afm/state"] > 200
    assert result.difference == ""
    assert result.identical
    assert result == before


@pytest.mark.parametrize(("field", "value"), [("mode", "estop"), ("meniscus", True), ("step_s", 2e-3)])
def test_a_changed_value_beside_an_added_key_is_a_difference(
    beginning: InMemory, say_more: Callable[..., None], field: str, value: Any
) -> None:
    say_more(temperature_k=293.0, **{field: value})
    result = rerun(beginning, "afm_node@slave", MachineTolerances(beginning, "afm_node@slave"))
    assert not result.identical
    assert (result.topic, result.field) == ("afm/state", field)


@pytest.mark.parametrize(
    ("recorded", "without", "field"),
    [
        # a recorded key that is missing now, beside a higher version and the same one
        ({"device": "ok", "v": 1}, (), "device"),
        ({"device": "ok"}, ("temperature_k",), "device"),
        ({"device": "ok", "v": 2}, ("temperature_k",), "device"),
        ({"temperature_k": 292.0, "v": 2}, (), "temperature_k"),
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
