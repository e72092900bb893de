"""The declared state of a node as bytes, and a node that was just built put into it."""

import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from telenano.extend.laws import HandSample
from telenano.wire.errors import RecordingError
from telenano.wire.messages import HapticCommand
from telenano.wire.node_state import FindInput, Part, is_whole, pack, part, restore

COMMAND = HapticCommand(
    seq=3, t_ns=4, src="a@b", v=1, mode="off", position_m=(0.0, -0.0, 1e-300), velocity_m_per_s=(0.0, 0.0, 0.0),
    force_n=(0.0, 0.0, 0.0), hand_seq=1, hand_t_ns=2,
)  # fmt: skip


class Counters(msgspec.Struct, array_like=True):
    """Of a part that is its own state."""

    seen: dict[str, int] = msgspec.field(default_factory=dict)


class ProbeState(NamedTuple):
    """The state of the node below."""

    sample: HandSample | None
    command: HapticCommand | None
    reported: tuple[str, tuple[int, ...]]
    last: list[HandSample]
    counters: Counters
    held: list[tuple[str, str, int, int]]
    law: Part | None


class Probe:
    """A node with a state, and nothing else of a node."""

    state_kind: Any = ProbeState
    state_version = 3

    def __init__(self) -> None:
        self.context = SimpleNamespace(key="n@s")
        self.state = ProbeState(None, None, ("", ()), [], Counters(), [], None)
        self.found: list[bytes] = []

    def capture(self) -> Any:
        return self.state

    def restore(self, state: Any, find: FindInput) -> None:
        self.state = state
        self.found = [find(topic, src, seq, 0, size_bytes) for topic, src, seq, size_bytes in state.held]


def restored(node: Any, *find: FindInput) -> Probe:
    other = Probe()
    restore(other, pack(node), *find)
    return other


def test_a_node_goes_on_from_the_state_of_another() -> None:
    node = Probe()
    node.state = ProbeState(
        sample=HandSample(1.0 / 3.0, -0.0, float("inf"), True),
        command=COMMAND,
        reported=("force", (2, 5)),
        last=[HandSample(0.0, 1.0, np.float64(2.0), False)],
        counters=Counters({"b@s": 1, "a@s": 2**62}),
        held=[("afm/state", "a@b", 4, 3), ("afm/state", "a@b", 5, 1)],
        law=part(Chosen(1.5, np.arange(3.0), HandSample(1.0, 2.0, 3.0, True))),
    )
    found = {4: b"xyz"}
    other = restored(node, lambda topic, src, seq, arrived_ns, size_bytes: found.get(seq, bytes(size_bytes)))
    assert other.state[:-1] == node.state[:-1]
    # the sign of a zero is kept, and numbers of NumPy become plain ones
    assert repr(other.state.command) == repr(COMMAND)
    assert repr((other.state.sample, other.state.last[0].force_n)) == repr((node.state.sample, 2.0))
    assert type(other.state.sample) is HandSample
    assert type(other.state.command) is HapticCommand
    assert other.found == [b"xyz", b"\0"]
    assert other.state.law is not None
    law = other.state.law.like(Chosen(0.0, np.zeros(0), HandSample(0.0, 0.0, 0.0, False)))
    assert (law.gain, law.history.tolist(), law.sample) == (1.5, [0.0, 1.0, 2.0], HandSample(1.0, 2.0, 3.0, True))


class Chosen(NamedTuple):
    """The state of a part that settings choose; its own part may be of any kind."""

    gain: float
    history: NDArray[np.float64]
    sample: Any = None


class Outer(NamedTuple):
    """A part in a part."""

    inner: Chosen
    count: int


@pytest.mark.parametrize(
    "state",
    [
        np.array([[0.1, -0.0], [np.pi, 5e-324]]),
        np.zeros((0, 3), np.int32),
        np.array([True, False]),
        Chosen(2.0, np.arange(2.0), np.array([7, 8], np.uint8)),
        Outer(Chosen(2.0, np.zeros(1), HandSample(0.0, 1.0, 2.0, True)), 4),
        (1.0, np.arange(4.0), (2, "a")),
        3.5,
        None,
    ],
    ids=repr,
)
def test_a_part_of_a_package_needs_no_declaration_beyond_its_fields(state: Any) -> None:
    node = Probe()
    node.state = node.state._replace(law=part(state))
    found = restored(node).state.law
    assert found is not None
    again = found.like(emptied(state))
    assert type(again) is type(state)
    assert repr(again) == repr(state)
    arrays = [value for value in (again, *(again if isinstance(again, tuple) else ())) if isinstance(value, np.ndarray)]
    # compiled steps take an array that cannot be written to for another type
    assert all(array.flags.writeable for array in arrays)


def emptied(state: Any) -> Any:
    """Return a state as it is at the start: of the same kinds, with other values."""
    if isinstance(state, np.ndarray):
        return np.zeros(1, state.dtype)
    if isinstance(state, tuple):
        made = map(emptied, state)
        return state._make(made) if hasattr(state, "_make") else tuple(made)
    return None if state is None else type(state)()


def renamed(source: str, *pairs: tuple[str, str]) -> Probe:
    for old, new in pairs:
        source = re.sub(rf"\b{old}\b", new, source)
    space: dict[str, Any] = {"__name__": "a_module_of_another_name"}
    exec(source, space)
    node: Probe = next(value for value in space.values() if hasattr(value, "state_kind"))()
    return node


SOURCE = """
from types import SimpleNamespace
from typing import Any, NamedTuple
import msgspec
from telenano.wire.node_state import Part, part

class Account(msgspec.Struct, array_like=True):
    joules: float = 0.0

class History(NamedTuple):
    newest: int
    values: tuple[float, ...]

class LawState(NamedTuple):
    wave: float

class NodeState(NamedTuple):
    account: Account
    history: History
    law: Part

class Node:
    state_kind, state_version = NodeState, 1
    context = SimpleNamespace(key="n@s")

    def __init__(self):
        self._account, self._history, self._law = Account(), History(0, ()), LawState(0.0)

    def capture(self):
        return NodeState(self._account, self._history, part(self._law))

    def restore(self, state, find):
        self._account, self._history, self._law = state.account, state.history, state.law.like(self._law)

    def step(self):
        self._account.joules += 0.1
        self._history = History(self._history.newest + 1, (*self._history.values, self._account.joules))
        self._law = LawState(self._law.wave - 1.0)
"""
RENAMED = (("_account", "_energy"), ("_law", "_half"), ("Account", "Ledger"), ("History", "Past"), ("Node", "Unit"))


def test_private_names_classes_and_modules_may_be_renamed() -> None:
    node: Any = renamed(SOURCE)
    for _ in range(3):
        node.step()
    other: Any = renamed(SOURCE, *RENAMED, ("LawState", "S"), ("NodeState", "T"))
    restore(other, pack(node))
    assert pack(other) == pack(node)
    for some in (node, other):
        some.step()
    assert pack(other) == pack(node)
    assert (other._energy.joules, other._history.newest) == (node._account.joules, 4)


MORE = "joules: float = 0.0\n    left: float = 0.0"
FITS = "n@s: its state in the journal does not fit this code: "


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("state_version = NodeState, 1", "state_version = NodeState, 2"), "it has version 1, and this code reads ver"),
        ((MORE, "joules: float = 0.0"), "it has in addition account.left$"),
        (("newest", "latest"), "it lacks history.latest and has in addition history.newest$"),
        (("newest: int\n    values: tuple[float, ...]", "values: tuple[float, ...]\n    newest: int"), "another order"),
        (("wave", "force"), "it lacks force and has in addition wave$"),
    ],
)
def test_a_state_of_another_version_or_with_other_fields_is_refused(change: tuple[str, str], sentence: str) -> None:
    source = SOURCE.replace("joules: float = 0.0", MORE) if change[0] == MORE else SOURCE
    assert change[0] in source
    node = renamed(source)
    with pytest.raises(RecordingError, match=FITS + f".*{sentence}"):
        restore(renamed(source.replace(*change)), pack(node))


ADDED = "law: Part\n    felt: History = History(-1, ())\n    left: int = -1"


@pytest.mark.parametrize(
    ("recorded", "fault"),
    [("law: Part", ""), (ADDED.rpartition("\n")[0], ""), (ADDED.replace("left", "lost"), "has in addition lost")],
)
def test_fields_at_the_end_with_a_default_may_be_missing_from_an_older_state(recorded: str, fault: str) -> None:
    newer = (
        SOURCE.replace("law: Part", ADDED)
        .replace("part(self._law))", "part(self._law), *self.added)")
        .replace("state.law.like(self._law)", "state.law.like(self._law)\n        self.added = state.felt, state.left")
    )
    older = SOURCE.replace("law: Part", recorded)
    node = renamed(newer)
    if fault:
        with pytest.raises(RecordingError, match=fault):
            restore(node, pack(renamed(older)))
        return
    restore(node, pack(renamed(older)))
    assert [tuple(node.added[0]), node.added[1]] == [(-1, ()), -1]
    assert pack(node) != pack(renamed(older))


def test_a_state_from_before_a_field_was_added_has_its_default() -> None:
    node: Any = renamed(SOURCE)
    node.step()
    other: Any = renamed(SOURCE.replace("joules: float = 0.0", MORE))
    restore(other, pack(node))
    assert (other._account.joules, other._account.left) == (node._account.joules, 0.0)


def test_a_field_with_a_default_that_stands_before_another_one_may_not_be_missing() -> None:
    """The values have places, so that the one behind it would be taken for it."""
    newer = SOURCE.replace("joules: float = 0.0", f"{MORE}\n    lost: float = 0.0")
    older = newer.replace("    left: float = 0.0\n", "")
    with pytest.raises(RecordingError, match=rf"{FITS}it lacks account\.left, before account\.lost"):
        restore(renamed(newer), pack(renamed(older)))


class Tip(NamedTuple):
    """A state of a part that is not that of the hand."""

    depth_m: float


class Law(NamedTuple):
    """A state with samples of a declared kind beside a part of any kind."""

    past: tuple[HandSample, ...] | None
    part: Any


class LawOfTips(NamedTuple):
    """The same two fields, where the samples are of another kind."""

    past: tuple[Tip, ...] | None
    part: Any


HAND = HandSample(1.0, 2.0, 3.0, True)


@pytest.mark.parametrize(
    ("state", "example", "sentence"),
    [
        (
            Chosen(1.0, np.zeros(1), HAND),
            Chosen(1.0, np.zeros(1), Tip(1.0)),
            "it lacks sample.depth_m and has",
        ),
        (Law((), HAND), Law((), Tip(1.0)), "it lacks part.depth_m and has in addition part.position_m"),
        (Law(None, HAND), LawOfTips(None, HAND), "it lacks past.depth_m and has in addition past.position_m"),
        (Law((HAND,), 1.0), LawOfTips((), 1.0), "it lacks past.depth_m and has in addition past.position_m"),
    ],
)
def test_a_part_with_other_fields_within_is_refused_and_they_are_named(state: Any, example: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        part(state).like(example)


def test_a_part_is_taken_as_one_of_a_class_whose_fields_it_has() -> None:
    assert part(Law((HAND,), 1.0)).of_kind(Law) == Law((HAND,), 1.0)
    with pytest.raises(ValueError, match=r"it lacks past\.depth_m and has in addition past\.position_m"):
        part(Law((), 1.0)).of_kind(LawOfTips)


def test_what_a_part_declares_fits_whether_there_is_something_in_it_or_not() -> None:
    node = Probe()
    for state, example in ((Law(None, HAND), Law((HAND,), HAND)), (Law((HAND, HAND), Tip(2.0)), Law(None, Tip(0.0)))):
        node.state = node.state._replace(law=part(state))
        found = restored(node).state.law
        assert found is not None
        assert found.like(example) == state


def test_a_part_with_more_or_fewer_values_is_refused() -> None:
    for values, example in (([1.0, 2.0], (1.0,)), ([1.0], (1.0, 2.0))):
        with pytest.raises(ValueError, match="argument 2 is"):
            Part((), values).like(example)
    names, values = part(Law(None, 1.0))
    for wrong in ([None], [None, 1.0, 2.0]):
        with pytest.raises(ValueError, match=f"it has {len(wrong)} values for 2 fields"):
            Part(names, wrong).like(Law(None, 1.0))
    assert Part(names, values).like(Law((), 0.0)) == Law(None, 1.0)


@pytest.mark.parametrize("value", [object(), lambda: None, 2**70, {1.0: {object()}}])
def test_what_cannot_be_kept_is_named(value: object) -> None:
    node = Probe()
    node.state = node.state._replace(law=part(Chosen(0.0, np.zeros(1), value)))
    with pytest.raises((TypeError, OverflowError), match=r"cannot be kept in a journal|can't serialize|out of range"):
        pack(node)


def test_a_node_without_a_state_gives_no_bytes() -> None:
    node = Probe()
    node.state = None  # type: ignore[assignment]
    assert pack(node) == b""


def test_a_state_that_lacks_a_byte_is_not_whole() -> None:
    node = Probe()
    node.state = node.state._replace(law=part(np.arange(5.0)))
    packed = pack(node)
    assert is_whole(packed)
    assert not any(is_whole(packed[:length]) for length in range(len(packed)))
    assert not is_whole(packed[:20] + packed[40:])


def encoded(*state: Any) -> bytes:
    return msgspec.msgpack.encode(state)


NAMES = msgspec.msgpack.decode(pack(Probe()))[1]
VALUES = msgspec.msgpack.decode(pack(Probe()))[2]


@pytest.mark.parametrize(
    "state",
    [
        b"",
        b"\xc1",
        encoded(1),
        encoded(3, NAMES),
        encoded(3, NAMES, VALUES[:-1]),
        encoded(3, NAMES, [*VALUES, 1]),
        encoded(3, NAMES, [["text", 0.0, 0.0, True], *VALUES[1:]]),
        encoded(3, NAMES, [None, {"seq": -1}, *VALUES[2:]]),
        encoded(3, NAMES, {"sample": "os:system"}),
        b"\x91" * 100_000,
    ],
)
def test_a_state_of_something_else_is_refused(state: bytes) -> None:
    with pytest.raises(RecordingError, match=FITS):
        restore(Probe(), state)
    assert not is_whole(b"\x91" * 100_000)


@pytest.mark.parametrize("array", [["|O", [1], bytes(8)], ["<f8", [2], bytes(8)], ["os", [], b""], 5, None])
def test_an_array_that_is_none_is_refused(array: Any) -> None:
    names, values = msgspec.msgpack.decode(msgspec.msgpack.encode(part(HandSample(0.0, 0.0, 0.0, True))), type=Part)
    assert Part(names, values).like(HandSample(1.0, 1.0, 1.0, False)) == HandSample(0.0, 0.0, 0.0, True)
    state: Callable[[], Any] = lambda: Part((), array).like(np.zeros(1))  # noqa: E731
    with pytest.raises((ValueError, TypeError)):
        state()


class Noise(NamedTuple):
    drawn: int
    base: tuple[float, float] = (0.0, 0.0)


class Instrument(NamedTuple):
    force_n: float
    noise: Noise = Noise(0)


def test_a_part_of_before_lacks_what_was_added_at_an_end_with_a_default_and_nothing_else() -> None:
    names, values = part(Instrument(1.0, Noise(3, (1.0, 2.0))))
    assert names == ("force_n", "noise", "noise.drawn", "noise.base")
    for kept in (Part(names, values), Part(names[:3], (1.0, (3,))), Part(names[:1], (1.0,))):
        expected = Instrument(*(Noise(*v) if isinstance(v, tuple) else v for v in kept.values))
        assert kept.like(Instrument(0.0)) == kept.of_kind(Instrument) == expected
    for lacking in ((), ("force_n", "noise", "noise.base"), ("noise", "noise.drawn")):
        with pytest.raises(ValueError, match=r"it (lacks|has)"):
            Part(lacking, values).like(Instrument(0.0))
