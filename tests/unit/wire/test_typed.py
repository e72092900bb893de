"""The fast way through the contract: what it takes, and that it leaves all else to the declared models.

That it reads nothing else than they do is checked with each payload of `test_codec.py`.
"""

import itertools
import math
from typing import Annotated, Any, ClassVar

import msgpack
import numpy as np
import pytest
from pydantic import Field, ValidationError
from wire_contract import WITH_ADDITIONS, examples

from telenano.wire import TOPICS, Message, accept, compose, encode
from telenano.wire.codec import _TYPED, MAX_PLAIN_BYTES, header_check
from telenano.wire.messages import AfmCommand, AfmState, LinkFate, LinkFates
from telenano.wire.ranges import POSITION, limited
from telenano.wire.typed import typed_form, typed_rows

LOOP = ("haptic/state", "haptic/command", "teleop/forward", "teleop/backward", "afm/command", "afm/state")
HEADER = {"seq": 7, "t_ns": 1_790_000_000_123_456_789, "src": "controller@slave", "v": 1}
COMMAND: dict[str, Any] = {
    "hand_seq": 5, "hand_t_ns": 9, **HEADER, "mode": "position", "base_position_m": (0.0, 0.0, -7e-3)
}  # fmt: skip


def example(topic: str) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, field in TOPICS[topic].model.model_fields.items():
        if name in TOPICS[topic].model.additions:
            continue
        kind = str(field.annotation)
        fields[name] = HEADER.get(name, (0.5, -0.25, 1e-9) if "tuple" in kind else 3)
        if field.annotation is bool:
            fields[name] = True
        elif field.annotation is float:
            fields[name] = 0.125
        elif "Literal" in kind:
            fields[name] = kind.split("'")[1]
        elif name == "law":
            fields[name] = "wave"
        elif name == "energy_j":
            fields[name] = None
    return fields


# above it the subsets of a message's optional keys are too many to try, and all pairs of them stand for the rest
MOST_TRIED = 8


def subsets(topic: str) -> list[tuple[str, ...]]:
    """Return the sets of optional keys to try: every one, of a message with many those of at most two, and all."""
    keys = tuple(TOPICS[topic].model.additions)
    most = len(keys) if len(keys) <= MOST_TRIED else 2
    found = [subset for size in range(most + 1) for subset in itertools.combinations(keys, size)]
    return found if keys in found else [*found, keys]


def with_keys(topic: str, keys: tuple[str, ...]) -> Message:
    """Return an ordinary message with these of its optional keys."""
    model = TOPICS[topic].model
    # the last of them has the keys of every version
    whole = [made for case, made in examples(TOPICS[topic]).items() if case.startswith("ordinary" + WITH_ADDITIONS)][-1]
    fields = {key: value for key, value in whole.model_dump().items() if key in keys or key not in model.additions}
    return limited(model, {**fields, "v": model.version_of(keys)})


@pytest.mark.parametrize("topic", LOOP)
def test_the_messages_of_the_loop_take_the_fast_way_with_the_same_bytes(topic: str) -> None:
    form = typed_form(TOPICS[topic].model, MAX_PLAIN_BYTES)
    assert form is not None
    fields = example(topic)
    message = limited(TOPICS[topic].model, fields)
    payload = encode(message)
    assert form.read(payload) is None  # its texts are not known yet
    form.note(message)
    read = form.read(payload)
    assert read == message
    assert read is not None
    assert encode(read) == payload
    composed = form.compose(dict(reversed(fields.items())))
    assert composed == (message, payload)
    assert composed is not None
    # what is absent may stand anywhere: it is not sent
    assert [key for key, value in composed[0] if value is not None] == [
        key for key, value in message if value is not None
    ]
    assert composed[0].model_copy(update={"seq": 8}).seq == 8


def test_messages_of_the_loop_have_optional_keys() -> None:
    extended = [topic for topic in _TYPED if TOPICS[topic].model.additions]
    assert extended == ["haptic/state", "operator/force", "teleop/forward", "afm/command", "afm/state", "link/key"]
    assert [len(subsets(topic)) for topic in extended] == [1 + 11 + 55 + 1, 2**1, 2**1, 2**2, 1 + 9 + 36 + 1, 2**5]


@pytest.mark.parametrize("topic", [topic for topic in _TYPED if TOPICS[topic].model.additions])
def test_every_subset_of_the_optional_keys_takes_the_fast_way(topic: str) -> None:
    model = TOPICS[topic].model
    form = typed_form(model, MAX_PLAIN_BYTES)
    assert form is not None
    # as a reader meets them: one after the other, each of them new
    for keys in subsets(topic):
        message = with_keys(topic, keys)
        payload, fields = encode(message), message.model_dump()
        form.note(message)
        read, composed = form.read(payload), form.compose(dict(reversed(fields.items())))
        assert read == message, keys
        assert composed == (message, payload), keys
        assert form.fields(payload) == fields
        for found in (read, composed[0]):
            assert found is not None
            assert encode(found) == payload
            assert found.model_dump() == fields
            assert vars(found).keys() == model.model_fields.keys()
        # a device that does not know a value says None, which is not sent
        said = form.compose({**dict.fromkeys(model.additions), **fields})
        assert said == (message, payload), keys
    for keys in subsets(topic):
        assert form.read(encode(with_keys(topic, keys))) is not None


_FLAGS = ("armed", "hand_armed", "placed")


@pytest.mark.parametrize("topic", [topic for topic in _TYPED if TOPICS[topic].model.additions])
def test_a_wrong_optional_key_is_left_to_the_declared_model(topic: str) -> None:
    model = TOPICS[topic].model
    form = typed_form(model, MAX_PLAIN_BYTES)
    assert form is not None
    for key in model.additions:
        message = with_keys(topic, (key,))
        fields = message.model_dump()
        form.note(message)
        # any short text is a name, and none is not
        for value in (
            *(("", "n" * 65) if key == "by" else ("sideways",)),
            math.nan,
            math.inf,
            2**63,
            -1e300,
            1.0 if key in _FLAGS else True,
            [1.0],
        ):
            wrong = {**fields, key: value}
            assert form.read(msgpack.packb(wrong)) is None
            assert form.compose(wrong) is None
            with pytest.raises(ValidationError):
                model(**wrong)
        assert form.read(msgpack.packb({**fields, "extra": 1})) is None
        assert form.compose({**fields, "extra": 1}) is None
        # one key in the place of another, and one more than the map is said to have
        payload, pair = encode(message), msgpack.packb(key) + msgpack.packb(fields[key])
        twice = payload.replace(msgpack.packb("seq") + msgpack.packb(fields["seq"]), pair)
        for broken in (twice, payload + pair, payload.replace(pair, b"")):
            assert form.read(broken) is None
            assert form.fields(broken) is None


def test_one_more_optional_key_keeps_the_fast_way_with_its_range() -> None:
    class Warmer(AfmState):
        version: ClassVar[int] = 3
        additions: ClassVar[dict[str, int]] = {**AfmState.additions, "lines": 3}
        lines: Annotated[int, Field(ge=1, le=8)] | None = None

    form = typed_form(Warmer, MAX_PLAIN_BYTES)
    assert form is not None
    fields = {**with_keys("afm/state", ("device",)).model_dump(), "v": 3}
    for lines in (1, 8):
        message = Warmer(**fields, lines=lines)
        form.note(message)
        assert form.read(encode(message)) == message
        assert form.compose({**fields, "lines": lines}) == (message, encode(message))
    for lines in (0, 9):
        assert form.read(msgpack.packb({**fields, "lines": lines})) is None
        assert form.compose({**fields, "lines": lines}) is None


def test_a_rule_that_a_field_adds_to_its_type_is_not_passed_over() -> None:
    class Ruled(Message):
        version: ClassVar[int] = 2
        additions: ClassVar[dict[str, int]] = {"lines": 2}
        lines: int | None = Field(default=None, ge=1)

    assert typed_form(Ruled, MAX_PLAIN_BYTES) is None


def test_optional_keys_in_another_order_are_left_to_the_declared_model() -> None:
    form = typed_form(AfmState, MAX_PLAIN_BYTES)
    assert form is not None
    message = with_keys("afm/state", ("device", "input_v"))
    fields = message.model_dump()
    form.note(message)
    for first in ("device", "input_v", "mode"):
        shuffled = {first: fields[first], **fields}
        assert form.read(msgpack.packb(shuffled)) is None
        assert form.compose(shuffled) == (message, encode(message))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("base_position_m", (math.nan, 0.0, 0.0)),
        ("base_position_m", (0.0, math.inf, 0.0)),
        ("base_position_m", (0.0, 0.0, math.nextafter(POSITION.high, math.inf))),
        ("base_position_m", (0.0, 0.0)),
        ("base_position_m", (True, 0.0, 0.0)),
        ("base_position_m", "abc"),
        ("seq", -1),
        ("seq", 2**63),
        ("seq", 1.0),
        ("seq", True),
        ("v", 0),
        ("v", AfmCommand.version + 1),
        ("mode", "sideways"),
        ("mode", b"hold"),
        ("src", "Controller@slave"),
        ("src", "afm_node@slave"),
        ("extra", 1),
    ],
)
def test_anything_else_is_left_to_the_declared_model(key: str, value: object) -> None:
    form = typed_form(AfmCommand, MAX_PLAIN_BYTES)
    assert form is not None
    form.note(AfmCommand(**COMMAND))
    assert form.read(msgpack.packb(COMMAND)) is not None
    fields = {**COMMAND, key: value}
    assert form.read(msgpack.packb(fields)) is None
    assert form.compose(fields) is None


def test_bounds_are_included_and_whole_numbers_become_floating_point() -> None:
    form = typed_form(AfmCommand, MAX_PLAIN_BYTES)
    assert form is not None
    form.note(AfmCommand(**COMMAND))
    fields = {**COMMAND, "base_position_m": (POSITION.low, POSITION.high, 1), "seq": 2**63 - 1}
    composed = form.compose(fields)
    assert composed == (AfmCommand(**fields), encode(AfmCommand(**fields)))
    read = form.read(msgpack.packb(fields))
    assert read is not None
    assert repr(read) == repr(AfmCommand(**fields))


def test_a_publisher_limits_and_reports_as_ever() -> None:
    said: list[str] = []
    message, payload = compose("afm/command", {**COMMAND, "base_position_m": (0.0, 0.0, -11.0)}, said.append)
    assert message == AfmCommand(**{**COMMAND, "base_position_m": (0.0, 0.0, -10.0)})
    assert payload == encode(message)
    assert said == [
        "AfmCommand: base_position_m.2 = -11.0 is out of range and is sent at the end of the range",
    ]
    message, _ = compose("afm/command", {**COMMAND, "base_position_m": (np.float64(0.5), 0.0, 0.0)}, said.append)
    assert isinstance(message, AfmCommand)
    assert message.base_position_m == (0.5, 0.0, 0.0)
    with pytest.raises(ValidationError):
        compose("afm/command", {**COMMAND, "base_position_m": (math.nan, 0.0, 0.0)}, said.append)


def test_a_peer_that_makes_up_names_fills_no_memory() -> None:
    form = typed_form(AfmCommand, MAX_PLAIN_BYTES)
    assert form is not None
    for number in range(1000):
        form.note(AfmCommand(**{**COMMAND, "src": f"node{number}@slave"}))
    taken = [number for number in range(1000) if form.compose({**COMMAND, "src": f"node{number}@slave"}) is not None]
    assert taken == list(range(256))


@pytest.mark.parametrize("topic", ["session/control", "session/event", "node/health", "node/journal", "afm/scanline"])
def test_what_holds_more_than_scalars_and_vectors_has_no_fast_way(topic: str) -> None:
    assert typed_form(TOPICS[topic].model, MAX_PLAIN_BYTES) is None


FATE: dict[str, Any] = {
    "topic": "teleop/forward", "seq": 4, "is_duplicate": False, "arrived_ns": 2**63 - 1, "delay_ns": 0, "queue_ns": 0,
    "held_ns": 0, "dropped": "", "duplicated": True, "reordered": False, "corrupted": True,
}  # fmt: skip


def fates(*rows: dict[str, Any], **changed: object) -> dict[str, Any]:
    return {**HEADER, "src": "delay_node@master", "direction": "forward", "fates": rows, **changed}


def test_rows_are_composed_to_the_declared_message_and_bytes() -> None:
    form = typed_rows(LinkFates, MAX_PLAIN_BYTES)
    assert form is not None
    fields = fates(FATE, {**FATE, "seq": 2**40, "dropped": "loss"})
    whole = LinkFates(**{**fields, "fates": tuple(LinkFate(**row) for row in fields["fates"])})
    # whose name it is, the declared model says first
    assert form.compose(fields) is None
    form.note(whole)
    assert form.compose(fields) == (whole, encode(whole))
    assert form.read(encode(whole)) is None


@pytest.mark.parametrize(
    "fields",
    [
        fates({**FATE, "seq": -1}),
        fates({**FATE, "delay_ns": 2**63}),
        fates({**FATE, "seq": 1.5}),
        fates({**FATE, "duplicated": 1}),
        fates({**FATE, "topic": "t" * 65}),
        fates({**FATE, "unknown": 1}),
        fates({key: value for key, value in FATE.items() if key != "dropped"}),
        fates(FATE, direction="sideways"),
        fates(FATE, v=2),
        fates(FATE, src="Nobody"),
        fates(*[FATE] * 40),
        fates(*[FATE] * 1025),
    ],
    ids=lambda fields: "",
)
def test_rows_that_are_not_in_order_are_left_to_the_declared_model(fields: dict[str, Any]) -> None:
    form = typed_rows(LinkFates, MAX_PLAIN_BYTES)
    assert form is not None
    form.note(LinkFates(**fates()))
    assert form.compose(fates(FATE)) is not None
    assert form.compose(fields) is None


def test_what_the_link_says_stays_in_range() -> None:
    reports: list[str] = []
    for _ in range(2):
        message, payload = compose("link/fates", fates({**FATE, "delay_ns": 2**63}), reports.append)
        assert accept("link/fates", payload) == message
        assert message.model_dump()["fates"][0]["delay_ns"] == 2**63 - 1
    assert len(reports) == 2


@pytest.mark.parametrize("topic", ["node/health", "node/journal", "link/status", "haptic/state"])
def test_only_scalars_and_one_array_of_records_are_rows(topic: str) -> None:
    assert typed_rows(TOPICS[topic].model, MAX_PLAIN_BYTES) is None


CHECKED = ("haptic/state", "teleop/forward", "law/status", "link/status", "link/fates", "node/health", "session/event")


@pytest.mark.parametrize("topic", CHECKED)
def test_ordinary_messages_are_found_valid_without_a_message(topic: str) -> None:
    for case in ("minimal", "ordinary", "nil", "highest", "unicode"):
        message = examples(TOPICS[topic])[case]
        assert header_check(topic)(encode(message)) == (message.seq, message.t_ns, message.src), case
