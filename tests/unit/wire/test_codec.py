"""Any bytes give a message or one WireError, quickly and in little memory; whatever is sent comes back the same."""

import math
import re
import struct
import time
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from processor_time import ratio_of_costs

from telenano.testing.filled_messages import examples, schema_of
from telenano.wire import Message, decode, encode
from telenano.wire.codec import (
    MAX_MESSAGE_BYTES,
    MAX_PLAIN_BYTES,
    MOST_BYTES,
    WireError,
    accept,
    decode_header,
    fields_of,
    keys_twice,
    read_header,
    sound_header,
)
from telenano.wire.messages import MAX_ITEMS, MAX_KEYS, MAX_ROWS, Array, InputHealth, NodeHealth, SessionControl
from telenano.wire.topics import OWN_TOPICS as TOPICS

TOPIC = st.sampled_from(list(TOPICS))
GOLDEN = {topic: [encode(message) for message in examples(row).values()] for topic, row in TOPICS.items()}
# far above the few milliseconds that the worst message needs, far below what an attack used to cost
SLOW_S = 1.0


def outcome(topic: str, payload: bytes, read: Callable[[str, bytes], Message] = decode) -> Message | WireError:
    """Decode within the time allowed; any other exception than WireError ends the test."""
    # of this process: what others take is no fault of the decoder
    started = time.process_time()
    try:
        result: Message | WireError = read(topic, payload)
    except WireError as error:
        result = error
        assert len(str(error)) < 1000
        assert str(error)
    assert time.process_time() - started < SLOW_S
    return result


def check_header(topic: str, payload: bytes, result: Message | WireError) -> None:
    """Check that a header which is found without an error is that of the message."""
    if topic in TOPICS and (header := sound_header(topic, payload)) is not None:
        assert isinstance(result, Message)
        assert header == (result.seq, result.t_ns, result.src, result.run)


def check(topic: str, payload: bytes) -> None:
    """Decode; a message that came out must have one encoding, which gives it back, and is accepted in its ranges."""
    result = outcome(topic, payload)
    check_header(topic, payload, result)
    if isinstance(result, Message):
        accepted = outcome(topic, payload, accept)
        canonical = encode(result)
        again = decode(topic, canonical)
        assert again == result
        assert encode(again) == canonical
        assert accepted == result or (isinstance(accepted, WireError) and accepted.reason == "range")


def example_fields(topic: str, case: str = "ordinary") -> dict[str, Any]:
    fields: dict[str, Any] = msgpack.unpackb(encode(examples(TOPICS[topic])[case]), use_list=False)
    return fields


def refused(topic: str, payload: bytes) -> WireError:
    with pytest.raises(WireError) as caught:
        decode(topic, payload)
    check_header(topic, payload, caught.value)
    return caught.value


# --- whatever msgpack can express, and what it cannot ---

_scalar = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**64 - 1),
    st.floats(),
    st.floats(width=32),
    st.text(max_size=20),
    st.binary(max_size=20),
    st.builds(msgpack.ExtType, st.integers(0, 127), st.binary(max_size=20)),
    st.builds(msgpack.Timestamp, st.integers(-(2**63), 2**63 - 1), st.integers(0, 10**9 - 1)),
)
_key = st.one_of(st.text(max_size=8), st.sampled_from(["seq", "src", "v", "t_ns", "mode", "inputs", "parameters"]))
anything = st.recursive(
    _scalar,
    lambda part: st.one_of(st.lists(part, max_size=5), st.dictionaries(_key, part, max_size=5)),
    max_leaves=12,
)


@given(TOPIC, st.binary(max_size=400))
@example("haptic/state", b"")
@example("haptic/state", b"\xc1")
@example("haptic/state", b"\x80\x80")
def test_any_bytes(topic: str, payload: bytes) -> None:
    check(topic, payload)


@pytest.mark.check("takes 1.8 s")
@given(st.text(max_size=40), st.binary(max_size=40))
def test_any_topic(topic: str, payload: bytes) -> None:
    result = outcome(topic, payload)
    assert topic in TOPICS or (isinstance(result, WireError) and result.reason == "topic")


@given(TOPIC, anything)
def test_any_msgpack(topic: str, value: Any) -> None:
    check(topic, msgpack.packb(value))


@pytest.mark.check("takes 1.7 s")
@settings(max_examples=400)
@given(TOPIC, st.data(), anything)
def test_one_field_replaced_by_anything(topic: str, data: st.DataObject, value: Any) -> None:
    fields = example_fields(topic)
    key = data.draw(st.sampled_from(sorted(fields)))
    check(topic, msgpack.packb({**fields, key: value}))


@pytest.mark.check("takes 1.4 s")
@settings(max_examples=600)
@given(TOPIC, st.data())
def test_valid_messages_with_bytes_changed(topic: str, data: st.DataObject) -> None:
    payload = bytearray(data.draw(st.sampled_from(GOLDEN[topic])))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(payload)))
        until = min(len(payload), at + data.draw(st.integers(0, 3)))
        payload[at:until] = data.draw(st.binary(max_size=3))
    check(topic, bytes(payload))


@given(TOPIC, TOPIC, st.data())
def test_a_message_on_the_topic_of_another_and_two_spliced(topic: str, other: str, data: st.DataObject) -> None:
    a, b = data.draw(st.sampled_from(GOLDEN[topic])), data.draw(st.sampled_from(GOLDEN[other]))
    needed = {field.name for field in msgspec.structs.fields(TOPICS[topic].model) if field.required}
    # a message that has all that another needs is read as one with keys that are not known; its source tells them apart
    if topic != other and not needed <= msgpack.unpackb(b).keys():
        assert isinstance(outcome(topic, b), WireError)
    check(topic, a[: data.draw(st.integers(0, len(a)))] + b[data.draw(st.integers(0, len(b))) :])


@pytest.mark.parametrize("topic", TOPICS)
def test_every_beginning_of_a_message_is_refused(topic: str) -> None:
    payload = GOLDEN[topic][1]
    for length in range(len(payload)):
        assert refused(topic, payload[:length]).reason == "malformed"
    assert refused(topic, payload + b"\xc0").reason == "malformed"


@given(st.binary(min_size=1, max_size=8))
def test_text_that_is_not_utf8(raw: bytes) -> None:
    payload = GOLDEN["session/event"][1].replace(b"gap closed", raw.ljust(10, b" ")[:10], 1)
    result = outcome("session/event", payload)
    try:
        raw.decode()
    except UnicodeDecodeError:
        assert isinstance(result, WireError)
        assert str(result) == "session/event: text is '<11 bytes>', must be text in UTF-8"
    else:
        assert isinstance(result, Message)


# --- what an attacker would send ---


def _nested(opening: bytes, depth: int) -> bytes:
    return opening * depth + b"\x01"


def _array32(length: int) -> bytes:
    return b"\xdd" + struct.pack(">I", length)


def _map32(length: int) -> bytes:
    return b"\xdf" + struct.pack(">I", length)


def _bombs() -> Iterator[tuple[str, str, bytes]]:
    full = MAX_MESSAGE_BYTES
    for depth in (100, 512, 1000, 1023, 1024, 1500, full - 1):
        yield f"arrays-{depth}-deep", "haptic/state", _nested(b"\x91", depth)
    for depth in (500, 1010, 1020):
        yield f"src-{depth}-deep-and-newer", "haptic/state", b"\x82\xa1v\x02\xa3src" + _nested(b"\x91", depth)
        yield f"maps-{depth}-deep", "session/control", b"\x81\xaaparameters" + _nested(b"\x81\xa1a", depth)
    for kind, code in {"str": 0xDB, "bin": 0xC6, "array": 0xDD, "map": 0xDF, "ext": 0xC9}.items():
        for length in (2**32 - 1, 2**31, full):
            yield (
                f"{kind}-of-{length}",
                "haptic/state",
                b"\x81\xa1a" + bytes([code]) + struct.pack(">I", length) + b"\x00",
            )
    yield "arrays-of-arrays", "haptic/state", (_array32(full) * 1000).ljust(full, b"\xc0")
    yield "most-items-nested", "haptic/state", b"\x81\xa1a" + (_array32(MAX_ITEMS) * 1000).ljust(full - 3, b"\xc0")
    yield "empty-maps", "node/health", b"\x81\xa6inputs" + _array32(1_000_000) + b"\x80" * 1_000_000
    yield "most-empty-maps", "node/health", b"\x81\xa6inputs" + _array32(MAX_ITEMS) + b"\x80" * MAX_ITEMS
    keys = b"".join(b"\xa3%03x\xc0" % i for i in range(MAX_KEYS))
    yield "most-unknown-keys", "haptic/state", _map32(MAX_KEYS) + keys
    yield "most-wrong-values", "session/control", b"\x81\xaaparameters" + _map32(MAX_KEYS) + keys
    crowd = _map32(MAX_KEYS) + keys
    yield "many-crowded-inputs", "node/health", b"\x81\xa6inputs" + _array32(200) + crowd * 200
    yield "too-many-keys", "haptic/state", _map32(140_000) + b"".join(b"\xa5%05x\xc0" % i for i in range(140_000))
    yield "long-key", "haptic/state", b"\x81\xdb" + struct.pack(">I", 1_000_000) + b"a" * 1_000_000 + b"\xc0"
    for topic, key, depths in (
        ("session/control", b"\xaaparameters", (5, 100, 1000)),
        ("link/fates", b"\xa5fates", (100,)),
    ):
        full = MOST_BYTES[TOPICS[topic].model]
        for depth in depths:
            chain = b"\x81\xa1a" * depth + b"\xc0"
            count = min(MAX_ITEMS, (full - 50) // len(chain))
            yield f"chains-of-{depth}-maps", topic, b"\x81" + key + _array32(count) + chain * count
            count = min(MAX_KEYS, (full - 50) // (len(chain) + 5))
            chains = b"".join(b"\xa4%04x" % number + chain for number in range(count))
            yield f"keys-with-chains-of-{depth}-maps", topic, b"\x81" + key + _map32(count) + chains
        for name, item in {"empty-maps": b"\x80", "empty-arrays": b"\x90", "nil": b"\xc0"}.items():
            row = _array32(MAX_ITEMS) + item * MAX_ITEMS
            count = (full - 50) // len(row)
            yield f"rows-of-{name}", topic, b"\x81" + key + _array32(count) + row * count
        deep = b"\x91" * 1000 + b"\xc0"
        yield "chains-of-arrays", topic, b"\x81" + key + _array32(500) + deep * 500
        yield "crowds", topic, b"\x81" + key + _array32(100) + crowd * 100
    yield "long-src-and-newer", "haptic/state", b"\x82\xa1v\x02\xa3src\xdb" + struct.pack(">I", 10**6) + b"a" * 10**6


@pytest.mark.parametrize(("topic", "payload"), [pytest.param(t, p, id=name) for name, t, p in _bombs()])
def test_a_bomb_costs_little_time_and_memory(topic: str, payload: bytes) -> None:
    assert isinstance(outcome(topic, payload), WireError)
    tracemalloc.start()
    try:
        refused(topic, payload)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 64 * MAX_MESSAGE_BYTES


@pytest.mark.parametrize("items", [1000, 4000, MAX_ITEMS])
@pytest.mark.parametrize("topic", ["haptic/command", "session/control", "node/health"])
def test_no_room_is_made_for_arrays_that_are_not_there(topic: str, items: int) -> None:
    # each announces more items than the whole frame has bytes
    payload = b"\x81\xaaparameters" + _array32(items) * 800
    tracemalloc.start()
    try:
        assert refused(topic, payload).reason == "malformed"
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2**18


@pytest.mark.check("takes 1.2 s")
def test_refusing_the_dearest_costs_a_few_times_taking_the_longest() -> None:
    """The longest message that a node sends is a report of 1000 fates."""
    fates = example_fields("link/fates")
    longest = msgpack.packb({**fates, "fates": fates["fates"][:1] * 1000})

    def take() -> None:
        assert isinstance(outcome("link/fates", longest, accept), Message)

    for name, topic, payload in [*_bombs(), *_wrong_all_over()]:

        def refuse(topic: str = topic, payload: bytes = payload) -> None:
            assert isinstance(outcome(topic, payload, accept), WireError)

        # the slowest 4 times on one machine, 8 on another
        ratio = ratio_of_costs(refuse, take, below=16.0)
        assert ratio < 16.0, f"{name} takes {ratio:.0f} times as long"


def _wrong_all_over() -> Iterator[tuple[str, str, bytes]]:
    wrong = {f"k{number}": None for number in range(MAX_KEYS)}
    for topic, key in {"session/control": "parameters", "session/event": "data", "node/health": "rejected"}.items():
        yield f"wrong {topic}", topic, msgpack.packb({**example_fields(topic), key: wrong})
    status = example_fields("link/status")
    ways = {way: {**status[way], "settings": wrong, "dropped": wrong} for way in ("forward", "backward")}
    yield "wrong link/status", "link/status", msgpack.packb({**status, **ways})
    for topic, key in {"node/health": "inputs", "link/fates": "fates", "node/journal": "inputs"}.items():
        row = example_fields(topic)[key][0]
        rows = (row,) * (MAX_ROWS - 1)
        last = {**row, **dict.fromkeys(row, b"")}
        yield f"wrong last row of {topic}", topic, msgpack.packb({**example_fields(topic), key: (*rows, last)})


@pytest.mark.parametrize(
    ("topic", "change", "reason", "named"),
    [
        ("haptic/state", {"position_m": (0.0, 0.0)}, "schema", "position_m"),
        ("haptic/state", {"position_m": (0.0, 0.0, 0.0, 0.0)}, "schema", "position_m"),
        ("haptic/state", {"position_m": {"x": 0.0}}, "schema", "position_m"),
        ("haptic/state", {"session_s": True}, "schema", "session_s"),
        ("haptic/state", {"session_s": "0.1"}, "schema", "session_s"),
        ("haptic/state", {"seq": 1.0}, "schema", "seq"),
        ("haptic/state", {"seq": True}, "schema", "seq"),
        ("haptic/state", {"seq": -1}, "schema", "seq"),
        ("haptic/state", {"seq": 2**63}, "schema", "seq"),
        ("haptic/state", {"t_ns": 2**64 - 1}, "schema", "t_ns"),
        ("haptic/state", {"estop": 1}, "schema", "estop"),
        ("haptic/state", {"mode": "flying"}, "schema", "mode"),
        ("haptic/state", {"src": "haptic_node"}, "schema", "src"),
        ("haptic/state", {"src": "haptic_node@master\n"}, "schema", "src"),
        ("haptic/state", {"src": "a@" + "b" * 63}, "schema", "src"),
        ("haptic/state", {"v": 0}, "schema", "v"),
        ("haptic/state", {"v": 5}, "newer_version", "version 5 from 'haptic_node@master'"),
        ("haptic/state", {"v": 2**64 - 1}, "newer_version", "update this node"),
        ("session/control", {"validty_s": 1.0}, "schema", "validty_s"),
        ("session/control", {b"seq": 1}, "malformed", "a key that is not text"),
        ("haptic/state", {7: 1}, "malformed", "a key that is not text"),
        ("session/control", {"id": ""}, "schema", "id"),
        ("session/control", {"id": "a b"}, "schema", "id"),
        ("session/control", {"parameters": {"gain": (1.0, 2.0)}}, "schema", "parameters.gain"),
        ("session/control", {"parameters": {"gain": math.nan}}, "schema", "parameters.gain"),
        ("session/control", {"parameters": {"gain": None}}, "schema", "parameters.gain"),
        ("session/control", {"parameters": {b"gain": 1.0}}, "schema", "parameters"),
        ("session/event", {"text": "x" * 4097}, "schema", "text"),
        ("session/event", {"id": "twice\n"}, "schema", "id"),
        ("session/event", {"level": "fatal"}, "schema", "level"),
    ],
)
def test_a_wrong_field_is_named(topic: str, change: dict[Any, Any], reason: str, named: str) -> None:
    error = refused(topic, msgpack.packb({**example_fields(topic), **change}))
    assert error.reason == reason
    assert str(error).startswith(f"{topic}: ")
    assert named in str(error)


def test_a_long_unknown_key_is_named_in_brief() -> None:
    error = refused("session/control", msgpack.packb({**example_fields("session/control"), "k" * 3000: 1.0}))
    assert error.reason == "schema"
    assert "kkkk" in str(error)
    assert len(str(error)) < 300


@pytest.mark.parametrize("topic", TOPICS)
def test_every_missing_key_is_named(topic: str) -> None:
    fields = example_fields(topic)
    for key in fields:
        error = refused(topic, msgpack.packb({k: v for k, v in fields.items() if k != key}))
        assert (error.reason, str(error)) == ("schema", f"{topic}: {key} is missing")


@pytest.mark.parametrize("value", [None, True, 7, 1.5, "text", b"raw", (1, 2)])
def test_what_is_not_a_map_is_refused(value: object) -> None:
    error = refused("haptic/state", msgpack.packb(value))
    assert error.reason == "malformed"
    assert "must be a map" in str(error)


def test_unknown_topics_and_oversized_messages_are_refused() -> None:
    error = refused("haptic/" + "x" * 10_000, b"\x80")
    assert error.reason == "topic"
    assert "haptic/state" in str(error)
    # a topic whose messages hold no maps and no data is short; the others have room for both
    for topic, most in (("haptic/state", MAX_PLAIN_BYTES), ("node/health", MAX_MESSAGE_BYTES)):
        assert MOST_BYTES[TOPICS[topic].model] == most
        assert refused(topic, b"\x00" * most).reason == "malformed"
        error = refused(topic, b"\x00" * (most + 1))
        assert error.reason == "oversized"
        assert str(most) in str(error)


def test_the_longest_message_of_every_plain_topic_has_room() -> None:
    for topic, row in TOPICS.items():
        for message in examples(row).values():
            assert 4 * len(encode(message)) < MOST_BYTES[TOPICS[topic].model]


@pytest.mark.parametrize("topic", TOPICS)
def test_of_a_key_given_twice_the_last_value_counts_and_a_verifier_sees_it(topic: str) -> None:
    fields = example_fields(topic)
    whole = accept(topic, msgpack.packb(fields))
    for key, value in fields.items():
        again = msgpack.Packer().pack_map_pairs([*fields.items(), (key, value)])
        assert accept(topic, again) == whole
        assert sound_header(topic, again) is None
        assert keys_twice(again) == [key]
        wrong = msgpack.Packer().pack_map_pairs([*fields.items(), (key, {"x": None})])
        assert key in str(refused(topic, wrong))
        right = msgpack.Packer().pack_map_pairs([(key, value), *fields.items()])
        assert accept(topic, right) == whole


@pytest.mark.parametrize("head", [b"\xde\x00\x08", b"\xdf\x00\x00\x00\x08"])
def test_a_map_may_say_its_size_in_more_bytes_than_it_needs(head: bytes) -> None:
    payload = encode(examples(TOPICS["afm/command"])["ordinary"])
    assert payload[0] == 0x88
    assert accept("afm/command", head + payload[1:]) == accept("afm/command", payload)


RANGED = [
    ("haptic/state", "position_m", 2, 10.0),
    ("haptic/state", "velocity_m_per_s", 0, 1e3),
    ("haptic/state", "operator_force_n", 2, 1e6),
    ("haptic/state", "session_s", None, 1e10),
    ("haptic/command", "force_n", 1, 1e6),
    ("teleop/forward", "position_m", 2, 1e6),
    ("teleop/forward", "wave_sqrt_w", 2, 1e6),
    ("teleop/backward", "energy_j", None, 1e12),
    ("teleop/backward", "force_n", 2, 1e6),
    ("afm/state", "base_position_m", 2, 10.0),
    ("afm/state", "tip_force_n", 2, 1e6),
    ("law/status", "port_power_w", None, 1e9),
]


@pytest.mark.parametrize(("topic", "key", "place", "bound"), RANGED)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_quantity_at_the_end_of_its_range_is_taken_and_one_beyond_is_not(
    topic: str, key: str, place: int | None, bound: float, sign: float
) -> None:
    fields = example_fields(topic)

    def with_value(value: float) -> bytes:
        whole = value
        if place is not None:
            whole = tuple(value if at == place else part for at, part in enumerate(fields[key]))
        payload: bytes = msgpack.packb({**fields, key: whole})
        return payload

    assert accept(topic, with_value(sign * bound)) == decode(topic, with_value(sign * bound))
    for beyond in (math.nextafter(sign * bound, sign * math.inf), sign * 1e308):
        with pytest.raises(WireError) as caught:
            accept(topic, with_value(beyond))
        assert caught.value.reason == "range"
        where = key if place is None else f"{key}.{place}"
        assert str(caught.value).startswith(f"{topic}: {where} is {beyond!r}, must be {-bound:g} to {bound:g} ")
        # a recording is read whatever it holds
        kept = fields_of(decode(topic, with_value(beyond)))[key]
        assert (kept if place is None else kept[place]) == beyond


def test_a_negative_count_or_duration_is_no_matter_of_range_to_who_reads() -> None:
    for change in ({"seq": -1}, {"step_s": -1e-9}):
        with pytest.raises(WireError, match=r"must be (a whole number from 0|0 to)"):
            decode("haptic/state", msgpack.packb({**example_fields("haptic/state"), **change}))


def test_quantities_beyond_their_range_are_read_inside_of_records_too() -> None:
    health = example_fields("node/health")
    rows = tuple({**row, "age_s": 1e300} for row in health["inputs"])
    payload = msgpack.packb({**health, "inputs": rows})
    with pytest.raises(WireError) as caught:
        accept("node/health", payload)
    assert caught.value.reason == "range"
    message = decode("node/health", payload)
    assert isinstance(message, NodeHealth)
    assert [(type(row), row.age_s) for row in message.inputs] == [(InputHealth, 1e300)] * len(rows)
    assert encode(message) == payload
    # and what else is wrong stays wrong
    assert refused("node/health", msgpack.packb({**health, "inputs": rows, "pid": -1})).reason == "schema"


def test_the_elements_of_an_array_have_a_range() -> None:
    beyond = struct.pack("<2d", 0.0, -10.5)
    with pytest.raises(WireError, match=r"height_m.data is -10.5, must be -10 to 10 m") as caught:
        accept("afm/scanline", _scanline(data=beyond))
    assert caught.value.reason == "range"
    assert fields_of(decode("afm/scanline", _scanline(data=beyond)))["height_m"]["data"] == beyond


def test_integers_and_short_floats_are_taken_where_a_number_is_meant() -> None:
    payload = msgpack.packb({**example_fields("haptic/state"), "position_m": (1, -2, 2**64 - 1)})
    assert fields_of(decode("haptic/state", payload))["position_m"] == (1.0, -2.0, float(2**64 - 1))
    short = msgpack.packb({**example_fields("haptic/state"), "session_s": 0.1}, use_single_float=True)
    value = fields_of(decode("haptic/state", short))["session_s"]
    assert value == struct.unpack("f", struct.pack("f", 0.1))[0]
    assert type(value) is float


# --- arrays ---


def _scanline(**array: Any) -> bytes:
    good = {"dtype": "f8", "shape": (2,), "data": bytes(16)}
    payload: bytes = msgpack.packb({**example_fields("afm/scanline"), "height_m": {**good, **array}})
    return payload


@pytest.mark.parametrize(
    ("array", "named"),
    [
        ({"shape": (3,)}, "needs 24"),
        ({"shape": (-2,)}, "shape.0"),
        ({"shape": (2**24 + 1,)}, "shape.0"),
        ({"shape": (2**24, 2**24, 2**24, 2**24)}, "needs"),
        ({"shape": (0, 2**24, 2**24, 2**24)}, "height_m"),
        ({"shape": (1, 1, 1, 1, 2)}, "shape"),
        ({"shape": 2}, "shape"),
        ({"shape": (2.0,)}, "shape.0"),
        ({"shape": ()}, "needs 8"),
        ({"dtype": "f2"}, "dtype"),
        ({"dtype": ">f8"}, "dtype"),
        ({"dtype": "O"}, "dtype"),
        ({"data": "0" * 16}, "data"),
        ({"data": bytes(15)}, "needs 16"),
        ({"data": struct.pack("<2d", 0.0, math.nan)}, "NaN"),
        ({"data": struct.pack("<2d", -math.inf, 0.0)}, "infinity"),
    ],
)
def test_an_array_that_does_not_fit_itself_is_refused(array: dict[str, Any], named: str) -> None:
    error = refused("afm/scanline", _scanline(**array))
    assert error.reason == "schema"
    assert "height_m" in str(error)
    assert named in str(error)


@given(
    st.sampled_from(["u1", "i2", "i4", "i8", "f4", "f8"]),
    st.lists(st.integers(0, 4), max_size=4),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_arrays_come_back_as_they_went(kind: str, shape: list[int], swap: bool, seed: int) -> None:
    array = np.asarray(np.random.default_rng(seed).integers(0, 128, shape)).astype(kind)
    # another byte order and another memory layout must not show
    other = array.astype(array.dtype.newbyteorder(">"), order="F") if swap else array
    sent = Array.from_numpy(other)
    assert np.array_equal(sent.to_numpy(), array)
    assert sent.to_numpy().shape == tuple(shape)
    check("afm/scanline", _scanline(dtype=sent.dtype, shape=sent.shape, data=sent.data))


@pytest.mark.parametrize("element", ["f2", "u8", "u4", "bool", "complex128", "U3", "datetime64[ns]"])
def test_other_element_types_are_refused_by_name(element: str) -> None:
    with pytest.raises(ValueError, match="cannot be sent, use one of u1, i2, i4, i8, f4, f8"):
        Array.from_numpy(np.zeros(2, dtype=element))


# --- every valid message ---

_EXACT = {
    "id": "[A-Za-z0-9_-]{1,64}",
    "law": "[a-z][a-z0-9_]{0,30}",
    "program": "[a-z][a-z0-9_]{0,31}",
    "public_key": "[0-9a-f]{64}",
    "answers": "([0-9a-f]{64})?",
    "src": "[a-z][a-z0-9_]{0,30}@[a-z][a-z0-9_]{0,30}",
}


def _strategy(schema: dict[str, Any], root: dict[str, Any], name: str = "") -> st.SearchStrategy[Any]:
    """Return the values that a JSON Schema of the contract allows."""
    if name in _EXACT:
        return st.from_regex(re.compile(_EXACT[name], re.ASCII), fullmatch=True)
    if "pattern" in schema:
        return st.from_regex(re.compile(schema["pattern"].strip("^$"), re.ASCII), fullmatch=True)
    if "$ref" in schema:
        record = schema["$ref"].rpartition("/")[2]
        return _arrays() if record == "Array" else _record(root["$defs"][record], root)
    if "anyOf" in schema:
        return st.one_of([_strategy(choice, root) for choice in schema["anyOf"]])
    if "const" in schema:
        return st.just(schema["const"])
    if "enum" in schema:
        return st.sampled_from(schema["enum"])
    if schema["type"] == "object":
        return st.dictionaries(st.text(max_size=8), _strategy(schema["additionalProperties"], root), max_size=3)
    if schema["type"] == "array":
        if "prefixItems" in schema:
            return st.tuples(*(_strategy(item, root) for item in schema["prefixItems"]))
        return st.lists(_strategy(schema["items"], root), max_size=2).map(tuple)
    highest = schema.get("maximum", schema.get("exclusiveMaximum", 2**63) - 1)
    return {
        "integer": st.integers(schema.get("minimum", -(2**63)), highest),
        "number": st.floats(schema.get("minimum"), schema.get("maximum"), allow_nan=False, allow_infinity=False),
        "boolean": st.booleans(),
        "string": st.text(min_size=schema.get("minLength", 0), max_size=min(schema.get("maxLength", 20), 20)),
        "null": st.none(),
    }[schema["type"]]


def _record(schema: dict[str, Any], root: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({k: _strategy(part, root, k) for k, part in schema["properties"].items()})


def _arrays() -> st.SearchStrategy[dict[str, Any]]:
    lengths = st.lists(st.integers(0, 3), min_size=1, max_size=4).map(tuple)
    return lengths.map(lambda shape: fields_of(Array.from_numpy(np.ones(shape, dtype="f8"))))


VALID = {topic: _record(schema_of(row), schema_of(row)) for topic, row in TOPICS.items()}


@pytest.mark.check("takes 2.0 s")
@settings(max_examples=400)
@given(TOPIC, st.data())
def test_every_valid_message_comes_back_the_same(topic: str, data: st.DataObject) -> None:
    message = msgspec.convert(data.draw(VALID[topic]), TOPICS[topic].model)
    payload = encode(message)
    again = accept(topic, payload)
    # repr distinguishes -0.0 from 0.0, 1 from 1.0 and from True
    assert repr(again) == repr(message)
    assert encode(again) == payload
    # the order of keys is free: the canonical one is the model's
    assert encode(decode(topic, msgpack.packb(dict(reversed(msgpack.unpackb(payload).items()))))) == payload


# --- the sender gets an error for what cannot be sent ---


def _control(**parameters: Any) -> SessionControl:
    fields = {**example_fields("session/control"), "parameters": parameters}
    return msgspec.convert(fields, SessionControl)


@pytest.mark.parametrize("value", [2**64, -(2**63) - 1, 2**200, "\ud800", "a\udfffb"])
def test_what_msgpack_cannot_hold_is_refused_when_sent(value: object) -> None:
    with pytest.raises(WireError, match="SessionControl cannot be sent") as caught:
        encode(_control(gain=value))
    assert caught.value.reason == "malformed"


def test_a_message_at_the_limit_passes_and_one_byte_more_is_refused_when_sent() -> None:
    most = MOST_BYTES[SessionControl]
    room = most - len(encode(_control(text="")))
    # a long string has a header of five bytes where the empty one has one
    largest = encode(_control(text="x" * (room - 4)))
    assert len(largest) == most
    assert isinstance(decode("session/control", largest), SessionControl)
    with pytest.raises(WireError, match=f"at most {most}") as caught:
        encode(_control(text="x" * (room - 3)))
    assert caught.value.reason == "oversized"


def test_what_the_model_allows_the_decoder_takes() -> None:
    assert encode(_control(**{str(i): i for i in range(MAX_KEYS)}))
    with pytest.raises(ValueError, match="length <= 1024"):
        _control(**{str(i): i for i in range(MAX_KEYS + 1)})
    health = example_fields("node/health")
    crowd = msgspec.convert({**health, "inputs": health["inputs"][:1] * MAX_ROWS}, TOPICS["node/health"].model)
    assert decode("node/health", encode(crowd)) == crowd
    with pytest.raises(ValueError, match="length <= 1024"):
        msgspec.convert({**health, "inputs": health["inputs"][:1] * (MAX_ROWS + 1)}, TOPICS["node/health"].model)


def test_a_header_is_read_without_its_message() -> None:
    fields = {"seq": 7, "t_ns": 8, "src": "haptic_node@master", "v": 1, "position_m": "nonsense"}
    header, found = decode_header("haptic/state", msgpack.packb(fields))
    assert header == (7, 8, "haptic_node@master")
    assert found == fields


@pytest.mark.parametrize(
    ("change", "reason", "text"),
    [
        ({"v": 9}, "newer_version", "schema version 9 from 'haptic_node@master' is newer than version 1 known here"),
        ({"seq": -1}, "schema", "seq is -1, must be a whole number from 0 to"),
        ({"t_ns": 2**63}, "schema", "t_ns is 9223372036854775808, must be a whole number from 0 to"),
        ({"src": 3}, "schema", "src is 3, must be str"),
        ({"v": True}, "schema", "v is True, must be int"),
        ({1: 2}, "malformed", "haptic/state: a key that is not text"),
    ],
)
def test_a_wrong_header_is_refused(change: dict[Any, Any], reason: str, text: str) -> None:
    fields = {"seq": 7, "t_ns": 8, "src": "haptic_node@master", "v": 1} | change
    with pytest.raises(WireError, match=text) as error:
        decode_header("haptic/state", msgpack.packb(fields))
    assert error.value.reason == reason
    with pytest.raises(WireError, match=text) as error:
        read_header("haptic/state", msgpack.packb(fields))
    assert error.value.reason == reason


def test_the_header_alone_is_that_of_the_message() -> None:
    for topic, payloads in GOLDEN.items():
        for payload in payloads:
            assert read_header(topic, payload) == decode_header(topic, payload)[0]


@given(TOPIC, st.data())
def test_what_is_cut_or_changed_has_the_same_header_or_is_refused(topic: str, data: st.DataObject) -> None:
    payload = bytearray(data.draw(st.sampled_from(GOLDEN[topic])))
    place = data.draw(st.integers(0, len(payload) - 1))
    payload[place] = data.draw(st.integers(0, 255))
    changed = bytes(payload[: data.draw(st.integers(place + 1, len(payload)))])
    try:
        whole = decode_header(topic, changed)[0]
    except WireError:
        return
    assert read_header(topic, changed) == whole


@pytest.mark.parametrize("payload", [b"", b"\xc0", b"\x81", msgpack.packb([1]), b"\x80\x00", b"\x91" * 5000])
def test_what_is_no_map_has_no_header(payload: bytes) -> None:
    with pytest.raises(WireError, match="haptic/state"):
        read_header("haptic/state", payload)
    with pytest.raises(WireError, match="unknown topic"):
        read_header("haptic/unknown", payload)
