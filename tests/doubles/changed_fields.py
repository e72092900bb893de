"""Recordings with extreme fields in messages: absent, nil, and the least and greatest possible value.

    for case in cases_of(path):
        write_changed(path, target, [case])

A case names a message and one of its fields. The values follow from the model of the message, so new fields have cases
too. There are also values that the model does not allow: readers must recognise such a message as invalid.
"""

import functools
import random
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import msgspec

from telenano.recording.quantities import model_of
from telenano.recording.reader import Recording
from telenano.recording.rewrite import CopyWriter
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.wire import decode, encode, example
from telenano.wire.nodes import site_of
from telenano.wire.topics import OWN_TOPICS

Path_ = tuple[str | int, ...]
_ABSENT = object()
# Keys that are not changed, because another sender or an older version would make another message.
_KEPT = ("src", "v")


class Case(NamedTuple):
    """A change of a message: its index in the file, topic, path of the field, and name and value of the change."""

    place: int
    topic: str
    path: Path_
    word: str
    value: Any

    @property
    def name(self) -> str:
        """The field and the name of its new value."""
        return f"{self.topic}.{'.'.join(map(str, self.path))} {self.word}"


def cases_of(path: Path, seed: int, *, of_each: int = 1) -> list[Case]:
    """Return the cases of a recording: `of_each` messages for each extreme value of each field of each channel."""
    dice = random.Random(seed)
    places: dict[tuple[str, str], list[int]] = {}
    payloads: list[tuple[str, bytes]] = []
    for place, message in enumerate(Recording(path).raw()):
        places.setdefault((message.channel.channel_topic, message.channel.src), []).append(place)
        payloads.append((dict(message.channel.metadata).get("topic", message.channel.topic), message.payload))
    cases = []
    for (channel, _), own in places.items():
        topic = payloads[own[0]][0]
        seen: set[tuple[Path_, str]] = set()
        # Sample several messages, because a field of a map, or an optional one, is only in some of them.
        for place in dice.sample(own, min(len(own), 40)):
            fields = msgpack.unpackb(payloads[place][1], use_list=True)
            for where, word, value in _changes(topic, fields):
                if (where, word) in seen:
                    continue
                seen.add((where, word))
                chosen = [place, *dice.sample(own, min(len(own), of_each - 1))]
                cases += [Case(one, channel, where, word, value) for one in chosen]
    dice.shuffle(cases)
    return cases


def with_examples(source: Path, target: Path) -> Path:
    """Copy a recording, with an example added for each missing topic of the core, half a second after the start."""
    whole = Recording(source)
    has = {channel.topic for channel in whole.channels}
    at_ns = whole.span_ns[0] + 500_000_000
    settings = FileSettings(directory=target.parent, file_name=target.name)
    writer = RecordingWriter.create("recorder@master", settings)
    for name, data in whole.attachments.items():
        writer.attach(name, "application/yaml", data, 0)
    for name, facts in whole.metadata.items():
        writer.add_metadata(name, facts)
    rows = [(one.log_ns, one.topic, one.src, one.site, one.publish_ns, one.seq, one.payload) for one in whole.select()]
    for topic in OWN_TOPICS:
        if topic not in has:
            made = msgspec.structs.replace(example(topic), t_ns=at_ns, seq=0)
            rows.append((at_ns, topic, made.src, site_of(made.src), at_ns, 0, encode(made)))
    numbers: dict[tuple[str, str, str], int] = {}
    for log_ns, topic, src, site, publish_ns, seq, payload in sorted(rows, key=lambda row: row[0]):
        if (topic, src, site) not in numbers:
            numbers[topic, src, site] = writer.channel(topic, src, site)
        writer.write(numbers[topic, src, site], log_ns, publish_ns, seq, payload)
    writer.finish({"state": "stopped", "note": ""})
    return writer.path


def is_valid(path: Path, cases: Sequence[Case]) -> list[bool]:
    """Return for each case whether the changed message is valid and has its number unchanged."""
    raw = list(Recording(path).raw())
    found = []
    for case in cases:
        message = raw[case.place]
        fields = msgpack.unpackb(message.payload, use_list=True)
        seq = fields["seq"]
        _set(fields, case.path, case.value)
        try:
            topic = dict(message.channel.metadata).get("topic", case.topic)
            found.append(decode(topic, msgpack.packb(fields)).seq == seq)
        except (ValueError, OverflowError):
            found.append(False)
    return found


def write_changed(source: Path, target: Path, cases: Sequence[Case]) -> Path:
    """Copy a recording with changed messages; the record of a message gets the message's stamp and number."""
    wanted: dict[int, list[Case]] = {}
    for case in cases:
        wanted.setdefault(case.place, []).append(case)
    recording = Recording(source)
    with CopyWriter(target) as writer:
        writer.copy_attachments_and_metadata([recording])
        for place, message in enumerate(recording.raw()):
            for case in wanted.get(place, ()):
                fields = msgpack.unpackb(message.payload, use_list=True)
                _set(fields, case.path, case.value)
                stamp, seq = fields.get("t_ns"), fields.get("seq")
                message = message._replace(payload=msgpack.packb(fields))
                if type(stamp) is int and 0 <= stamp < 2**64 and type(seq) is int and seq >= 0:
                    message = message._replace(publish_ns=stamp, seq=seq & 0xFFFF_FFFF)
            writer.add(message)
    return target


def _set(fields: Any, path: Path_, value: Any) -> None:
    for part in path[:-1]:
        fields = fields[part]
    if value is not _ABSENT:
        fields[path[-1]] = value
    elif isinstance(fields, dict):
        fields.pop(path[-1], None)


def _changes(topic: str, fields: Mapping[str, Any]) -> Iterator[tuple[Path_, str, Any]]:
    """Yield the path of each field of a message with the name of a new value, and that value."""
    model = model_of(topic)
    declared = {} if model is None else _declared(model)
    for key in dict.fromkeys((*fields, *declared)):
        if key not in _KEPT:
            yield from _of_value((key,), fields.get(key, _ABSENT), declared.get(key))


def _of_value(path: Path_, value: Any, kind: Any) -> Iterator[tuple[Path_, str, Any]]:
    if value is not _ABSENT and isinstance(path[-1], str):
        yield path, "absent", _ABSENT
    if value is not None:
        yield path, "nil", None
    for word, extreme in _extremes(kind):
        yield path, word, extreme
    inner = _parts_of(kind)
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _of_value((*path, key), one, inner.get(key, inner.get(...)))
    elif isinstance(value, list):
        for place in dict.fromkeys((0, len(value) - 1)) if value else ():
            yield from _of_value((*path, place), value[place], inner.get(place, inner.get(...)))


@functools.cache
def _declared(model: type) -> dict[str, Any]:
    return {field.encode_name: field.type for field in msgspec.inspect.type_info(model).fields}


def _choices(kind: Any) -> list[Any]:
    """Return the types that a field may have, without nil."""
    while isinstance(kind, msgspec.inspect.Metadata):
        kind = kind.type
    kinds = kind.types if isinstance(kind, msgspec.inspect.UnionType) else [kind]
    return [one.type if isinstance(one, msgspec.inspect.Metadata) else one for one in kinds if one is not None]


def _parts_of(kind: Any) -> dict[Any, Any]:
    parts: dict[Any, Any] = {}
    for one in _choices(kind):
        if isinstance(one, msgspec.inspect.StructType):
            parts |= {field.encode_name: field.type for field in one.fields}
        elif isinstance(one, msgspec.inspect.TupleType):
            parts |= dict(enumerate(one.item_types))
        elif isinstance(one, msgspec.inspect.VarTupleType | msgspec.inspect.ListType):
            parts[...] = one.item_type
        elif isinstance(one, msgspec.inspect.DictType):
            parts[...] = one.value_type
    return parts


def _extremes(kind: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the extremes of a type, by its own bounds and by those of its encoding."""
    for one in _choices(kind):
        if isinstance(one, msgspec.inspect.FloatType):
            yield from (("least", float(one.ge)),) if one.ge is not None else ()
            yield from (("greatest", float(one.le)),) if one.le is not None else ()
            yield from (("least float", -sys.float_info.max), ("greatest float", sys.float_info.max), ("zero", 0.0))
        elif isinstance(one, msgspec.inspect.IntType):
            yield "least", -(2**63) if one.ge is None else one.ge
            yield "greatest", 2**64 - 1 if one.le is None else one.le
        elif isinstance(one, msgspec.inspect.BoolType):
            yield from (("no", False), ("yes", True))
        elif isinstance(one, msgspec.inspect.StrType):
            yield from (
                ("least", ""),
                ("greatest", "x" * min(one.max_length or 200, 2000)),
                ("foreign", "\u0130\u202e\x1b["),
            )
        elif isinstance(one, msgspec.inspect.LiteralType):
            yield from ((str(word), word) for word in one.values)
        elif isinstance(one, msgspec.inspect.DictType):
            yield "empty", {}
        elif isinstance(one, msgspec.inspect.VarTupleType):
            yield "empty", []
