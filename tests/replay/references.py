"""The reference sessions: rows that the virtual rig runs, and digests of what their nodes say.

A reference is a law, a link, a seed and a duration. `telenano.virtual` makes the same messages of it on
every machine whose C library gives the same bits, and `digests.json` has a digest of each of their fields. Neither BLAS
nor our compiler may change them; only the C library may, where it has other instructions, and then within a billionth.

    python tests/replay/references.py FOLDER

re-runs each node from the recordings of that folder, and prints what differs (see `test_rerun.py`).
"""

import hashlib
import json
import math
import os
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

from in_memory import InMemory

from telenano.numerics.compiler import compiled_form, is_step
from telenano.recording.field_differences import Tolerances
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.sections.controller_section import LAWS, OWN_LAWS
from telenano.virtual import LINK_NODE, NODES, record_session

FOLDER = Path(__file__).resolve().parent
DIGESTS = FOLDER / "digests.json"
# The variable of the environment with which every step of the nodes is compiled.
COMPILED = "TELENANO_TEST_COMPILED"
# of the greatest value that a field has in the recording
SHARE = 1e-9
RERUN = (LINK_NODE, *NODES)


class Reference(NamedTuple):
    """What a session is made of.

    Attributes: law; forward and backward, what the link does in either direction, backward as forward where it is
    None; seed, of all delays on the sites. The scenario is the short one of the virtual rig.
    """

    law: str
    forward: Mapping[str, Any]
    seed: int
    backward: Mapping[str, Any] | None = None


# one for each law, and one for the link: together all that a link does to messages
REFERENCES = {
    "virtual_impedance": Reference("virtual_impedance", {"delay_s": 0.003}, 7),
    "position_force": Reference(
        "position_force",
        {"delay_s": 0.003, "jitter": {"scale_s": 0.002, "correlation": 0.5}, "duplication": {"probability": 0.02}},
        8,
    ),
    "wave": Reference(
        "wave",
        {"delay_s": 0.002, "gilbert_elliott": {"p": 0.01, "r": 0.3}, "loss": {"probability": 0.02, "correlation": 0.4}},
        9,
    ),
    "smith": Reference(
        "smith",
        {
            "delay_s": 0.004,
            "jitter": {"scale_s": 0.001, "distribution": "pareto", "correlation": 0.9},
            "order": "topic",
            "rate": {"rate_bytes_per_s": 350_000.0, "overhead_bytes": 54},
            "queue": {"limit_messages": 4, "drop": "random"},
        },
        10,
    ),
    "passivity": Reference(
        "passivity",
        {
            "delay_s": 0.003,
            "reordering": {"probability": 0.1, "gap": 3},
            "topics": {name: {"corruption": {"probability": 0.3, "bits": 4}} for name in ("law/*", "node/*")},
        },
        11,
    ),
    "model_mediated": Reference(
        "model_mediated",
        {
            "delay_s": 0.001,
            "slots": {"min_interval_s": 0.002, "max_interval_s": 0.005},
            "outage": {"mean_up_s": 0.2, "mean_down_s": 0.02, "mode": "hold"},
        },
        12,
    ),
    # much at once; what is damaged are figures that no device acts on
    "link": Reference(
        "virtual_impedance",
        {
            "delay_s": 0.004,
            "jitter": {"scale_s": 0.001, "distribution": "pareto", "correlation": 0.9},
            "gilbert_elliott": {"p": 0.01, "r": 0.3},
            "order": "topic",
            "rate": {"rate_bytes_per_s": 400_000.0, "overhead_bytes": 54},
            "queue": {"limit_messages": 5, "drop": "random"},
        },
        13,
        backward={
            "delay_s": 0.003,
            "jitter": {"scale_s": 0.001},
            "loss": {"probability": 0.02, "correlation": 0.5},
            "duplication": {"probability": 0.03},
            "reordering": {"probability": 0.02, "gap": 3},
            "topics": {"law/*": {"corruption": {"probability": 0.3, "bits": 4}}},
        },
    ),
}
# the laws of the core, and two of a package that have been here from the beginning
REFERENCED = (*OWN_LAWS, "model_mediated", "smith")
# what the nodes say to one another: health and journals tell of the process, events are sentences
DIGESTED = (
    "haptic/state", "haptic/command", "teleop/forward", "teleop/backward", "afm/command", "afm/state", "law/status",
    "link/fates", "link/status", "link/delay", "clock/ping", "clock/pong",
)  # fmt: skip


def record(name: str, folder: Path) -> Path:
    """Record a session in a folder, which is made."""
    row = REFERENCES[name]
    forward, backward = dict(row.forward), dict(row.forward if row.backward is None else row.backward)
    settings = [f"controller.law={row.law}"]
    settings += [f"delay_node.{way}={json.dumps(does)}" for way, does in (("forward", forward), ("backward", backward))]
    folder.mkdir(parents=True, exist_ok=True)
    return record_session(folder, row.seed, settings)


class Field(NamedTuple):
    """What one field of all messages of a channel was.

    Attributes: count, of its values; digest, of their bits; mean and root mean square, of whole numbers from the first
    of them on, zero where there are none.
    """

    count: int
    digest: str
    mean: float
    rms: float


# by channel and field
Digests = Mapping[str, Mapping[str, Field]]


def digests_of(recording: Recording) -> dict[str, dict[str, Field]]:
    """Return the digest of each field of what each node said."""
    values: dict[str, dict[str, list[Any]]] = {}
    for message in recording.messages(DIGESTED):
        channel = values.setdefault(f"{message.src} {message.topic}", {})
        for name, value in leaves(message.fields()):
            # they follow from the place of the message and from what else it says
            if name not in ("src", "seq", "v"):
                channel.setdefault(name, []).append(value)
    return {
        channel: {name: field_of(found) for name, found in sorted(fields.items())}
        for channel, fields in sorted(values.items())
    }


def leaves(fields: Any, stem: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and the values of all fields; all rows of a table have one name."""
    if isinstance(fields, Mapping):
        for key, value in fields.items():
            yield from leaves(value, f"{stem}.{key}" if stem else str(key))
    elif isinstance(fields, list | tuple):
        for place, value in enumerate(fields):
            yield from leaves(value, f"{stem}.{'*' if isinstance(value, Mapping) else place}")
    else:
        yield stem, fields


def field_of(values: Sequence[Any]) -> Field:
    """Return the digest of values in their order, and their moments, which no order changes."""
    bits = hashlib.sha256()
    for value in values:
        bits.update(struct.pack("<d", value) if isinstance(value, float) else repr(value).encode() + b"\n")
    numbers = [value for value in values if isinstance(value, int | float)]
    # whole numbers are counts and nanoseconds since long ago: what matters is by how much they go on
    origin = numbers[0] if numbers and isinstance(numbers[0], int) else 0
    numbers, count = [float(number - origin) for number in numbers], max(1, len(numbers))
    mean, square = math.fsum(numbers) / count, math.fsum(number * number for number in numbers) / count
    return Field(len(values), bits.hexdigest()[:12], mean, math.sqrt(square))


def c_library() -> str:
    """Return a digest of what the C library makes of a thousand numbers: it differs where its instructions do."""
    bits = hashlib.sha256()
    functions = (math.exp, math.sin, math.cos, math.tan, math.log, math.log1p, math.expm1, math.erfc, math.tanh)
    for n in range(1, 1001):
        number = n * 0.0137
        bits.update(struct.pack("<10d", *(function(number) for function in functions), math.pow(number, 1.37)))
    return bits.hexdigest()[:12]


def differences(kept: Digests, found: Digests, *, same_bits: bool) -> list[str]:
    """Return in sentences what found digests lack or have otherwise; a field or channel more is none.

    `same_bits` asks for the bits, otherwise mean and root mean square may be off by the billionth part of the latter.
    """
    told = []
    for channel, fields in kept.items():
        if channel not in found:
            told.append(f"{channel}: says nothing any more")
            continue
        for name, before in fields.items():
            text = _difference(before, found[channel].get(name), same_bits)
            told += [f"{channel}: {name} {text}"] if text else []
    return told


def additions(kept: Digests, found: Digests) -> list[str]:
    """Return in sentences what found digests have besides."""
    return [
        f"{channel}: {name} is new"
        for channel, fields in found.items()
        for name in fields
        if name not in kept.get(channel, {})
    ]


def _difference(before: Field, now: Field | None, same_bits: bool) -> str:
    if now is None:
        return "is not said any more"
    if now.digest == before.digest:
        return ""
    if now.count != before.count:
        return f"has {now.count} values, {before.count} before"
    allowed = 0.0 if same_bits else SHARE * max(before.rms, now.rms)
    moments = (("mean", before.mean, now.mean), ("root mean square", before.rms, now.rms))
    moved = [f"{word} {is_now!r}, {was!r} before" for word, was, is_now in moments if abs(was - is_now) > allowed]
    # words have no moments
    unmoved = "has other values" if same_bits or before.rms == now.rms == 0.0 else ""
    return ", ".join(moved) or unmoved


def read_digests(path: Path = DIGESTS) -> tuple[str, dict[str, dict[str, dict[str, Field]]]]:
    """Return the C library with which the digests were made, and those of each reference."""
    document = json.loads(path.read_text(encoding="utf-8"))
    sessions = {
        name: {channel: {key: Field(*value) for key, value in fields.items()} for channel, fields in channels.items()}
        for name, channels in document["sessions"].items()
    }
    return document["c_library"], sessions


def write_digests(sessions: Mapping[str, Digests], path: Path = DIGESTS) -> None:
    """Write the digests, a line for each field."""
    path.write_text(_text({"c_library": c_library(), "sessions": sessions}) + "\n", encoding="utf-8")


def _text(value: Any, indent: str = "") -> str:
    if not isinstance(value, Mapping):
        return json.dumps(value)
    rows = (f"{indent} {json.dumps(key)}: {_text(inner, indent + ' ')}" for key, inner in value.items())
    return "{\n" + ",\n".join(rows) + f"\n{indent}}}"


class MachineTolerances(Tolerances):
    """What the figures of a node may differ by with another C library than that of the recording.

    They are found when a message differs for the first time: with the same library none does.
    """

    def __init__(self, recording: Recording, node: str) -> None:
        super().__init__()
        self._recording, self._node = recording, node

    @cached_property
    def _allowed(self) -> Tolerances:
        # the link's figures are whole nanoseconds: one where a random delay falls between two of them
        limits = {"link/fates:fates.*_ns": 1.0, "link/status:*": 1e-9} if self._node == LINK_NODE else {}
        for message in self._recording.messages(DIGESTED):
            if message.src != self._node:
                continue
            for field, value in message.fields().items():
                for part in value if isinstance(value, tuple) else (value,):
                    if isinstance(part, float):
                        name = f"{message.topic}:{field}"
                        limits[name] = max(limits.get(name, 0.0), SHARE * abs(part))
        return Tolerances(limits)

    def on(self, topic: str) -> Tolerances:
        return self._allowed.on(topic)


class Rerun(NamedTuple):
    """What came of a re-run on another processor: the difference in bits, and that beyond the tolerance."""

    compared: int
    bits: str
    beyond: str


def reruns_of(folder: Path) -> dict[str, Rerun]:
    """Re-run each node from the recording of each reference in a folder."""
    found = {}
    for name in REFERENCES:
        recording = InMemory(folder / name / "session.mcap")
        for node in RERUN:
            result = rerun(recording, node)
            beyond = result
            if not result.identical:
                beyond = rerun(recording, node, MachineTolerances(recording, node))
            told = [each.difference or each.ended_early for each in (result, beyond)]
            found[f"{name} {node}"] = Rerun(sum(beyond.compared.values()), *told)
    return found


def compile_every_step() -> None:
    """Put the compiled form in the place of every step that the nodes call as plain Python."""
    for name, law in LAWS.items():
        LAWS[name] = replace(
            law, **{key: compiled_form(value) for key, value in vars(law).items() if callable(value) and is_step(value)}
        )
    for module in [found for name, found in sys.modules.items() if name.startswith(("services.", "telenano."))]:
        for name, value in list(vars(module).items()):
            if isinstance(value, FunctionType) and is_step(value):
                setattr(module, name, compiled_form(value))


if __name__ == "__main__":
    if COMPILED in os.environ:
        compile_every_step()
    sys.stdout.write(json.dumps({"c_library": c_library(), "reruns": reruns_of(Path(sys.argv[1]))}))
