"""Frames that no real node sends, for fuzz tests: extreme messages within the schemas, and broken ones, from a seed."""

import math
import random
import re
import string
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from telenano.sections.controller_section import OWN_LAWS as LAWS
from telenano.sections.controller_section import ControllerConfig
from telenano.settings.config import flatten
from telenano.settings.link_settings import LinkSettings
from telenano.testing.filled_messages import examples, schema_of
from telenano.wire import Topic, encode
from telenano.wire.codec import fields_of
from telenano.wire.messages import Array
from telenano.wire.nodes import LINK, NODES, name_of
from telenano.wire.topics import OWN_TOPICS as TOPICS

# Keys that a command may set, by node.
KEYS: dict[str, tuple[str, ...]] = {
    "controller": tuple(flatten(ControllerConfig().model_dump())),
    "delay_node": (*LinkSettings().flattened(), "forward.topics.teleop/forward.delay_s"),
    "player": (
        *("player.rate", "player.seek_s", "player.skip_s", "player.a_s", "player.b_s", "player.step", "player.pause"),
    ),
    "recorder": ("record.status", "record.split"),
}
NONSENSE = (".".join("a" * 5000), "", "a..b", "x" * 100_000)
VALUES = (
    1e300, -1e300, 1e-300, -1e-300, 5e-324, -0.0, 0.0, 1.0, -1.0, 0.01, 1e-3, 1e9, 1e-9, 1e15, 2**63 - 1, -(2**63),
    2**64 - 1, 0, 1, True, False, "", "none", "table", "/etc/passwd", "/dev/zero", "/proc/self/mem", "\0", "x" * 4096,
    "wave", "smith", "0:1, 2:3", "1:1e300", *LAWS,
)  # fmt: skip
TARGETS = ("*", "controller@slave", "controller@master", "afm_node", "haptic_node", "[", "", "*" * 64)


@dataclass
class Frames:
    """Makes frames; `now_ns` is the time on the readers' clock [ns].

    gentle: leaves out commands that would change the basis on which a live session is judged: its programme, law, dead
    band, link and files.
    """

    seed: str
    now_ns: int = 0
    gentle: bool = False

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self._seq: dict[tuple[str, str], int] = {}
        self._schemas = {name: schema_of(row) for name, row in TOPICS.items()}
        self._valid = {name: [encode(m) for m in examples(row).values()] for name, row in TOPICS.items()}

    # --- frames that the schemas allow ---

    def extreme(self, topic: str) -> bytes:
        """Return an encoded message that the schema of a topic allows, with values at the ends of their ranges."""
        schema = self._schemas[topic]
        fields = self._object(schema, schema)
        if topic == "session/control":
            fields |= self._command()
        fields |= self._header(TOPICS[topic])
        payload: bytes = msgpack.packb(fields)
        return payload

    def _header(self, row: Topic) -> dict[str, Any]:
        rng = self.random
        known = [node.key for node in NODES] + ["fuzz@slave", "fuzz@master", "a@b", "n" * 31 + "@" + "s" * 32]
        if self.gentle and row.name == "link/delay":
            # A message in the name of the link would change the permitted age of the hand's samples.
            known = [key for key in known if name_of(key) != LINK]
        src = rng.choice(known) if rng.random() < 0.9 else f"made_up_{rng.randrange(2000)}@slave"
        seq = self._seq.get((row.name, src), -1) + 1
        if rng.random() < 0.03:
            seq = rng.choice((0, seq + 5, seq + 10_000, 2**63 - 1, 2**62))
        self._seq[row.name, src] = min(seq, 2**63 - 2)
        t_ns = self._time_ns()
        return {"seq": seq, "t_ns": t_ns, "src": src, "v": row.model.version}

    def _time_ns(self) -> int:
        rng = self.random
        if rng.random() < 0.9:
            return max(0, self.now_ns - rng.choice((0, 0, 1000, 10**6, 50 * 10**6, 10**9)))
        return rng.choice((0, 1, 2**63 - 1, self.now_ns + 10**9, self.now_ns + 10**15))

    def _command(self) -> dict[str, Any]:
        rng = self.random
        target = "controller" if self.gentle else rng.choice(list(KEYS))
        keys = [key for key in KEYS[target] if not self.gentle or not key.startswith(("law", "deadband"))]
        if rng.random() < 0.1:
            keys = list(NONSENSE)
        parameters = {rng.choice(keys): rng.choice(VALUES) for _ in range(rng.choice((0, 1, 1, 1, 1, 2, 5)))}
        if rng.random() < 0.01:
            parameters = {f"k{number}": 1.0 for number in range(1024)}
        commands = ("set", "mark", "arm", "start", *(() if self.gentle else ("stop", "estop")))
        command = "set" if rng.random() < 0.8 else rng.choice(commands)
        return {
            "command": command,
            "parameters": parameters,
            "target": target if rng.random() < 0.8 else rng.choice(TARGETS),
        }

    def _object(self, schema: Mapping[str, Any], root: Mapping[str, Any]) -> dict[str, Any]:
        return {name: self._value(part, root, name) for name, part in schema["properties"].items()}

    def _value(self, schema: Mapping[str, Any], root: Mapping[str, Any], name: str = "") -> Any:
        rng = self.random
        if "$ref" in schema:
            kind = schema["$ref"].rpartition("/")[2]
            return self._array() if kind == "Array" else self._object(root["$defs"][kind], root)
        if "anyOf" in schema:
            return self._value(rng.choice(schema["anyOf"]), root, name)
        if "const" in schema:
            return schema["const"]
        if "enum" in schema:
            return rng.choice(schema["enum"])
        if schema["type"] == "object":
            return self._object_of(schema["additionalProperties"], root)
        return getattr(self, f"_{schema['type']}")(schema, root, name)

    def _number(self, schema: Mapping[str, Any], root: Any, name: str) -> float:
        rng = self.random
        low, high = schema.get("minimum", -1.7976931348623157e308), schema.get("maximum", 1.7976931348623157e308)
        if rng.random() < 0.3:
            return float(rng.choice((low, high)))
        ordinary = rng.choice((0.0, -0.0, 5e-324, 1e-9, 7e-9, 1e-3, 0.5, 1.0))
        spread = math.copysign(math.exp(rng.uniform(-30.0, math.log(max(high, 1e-9)))), rng.random() - 0.5)
        return float(min(max(float(rng.choice((ordinary, -ordinary, spread))), low), high))

    def _integer(self, schema: Mapping[str, Any], root: Any, name: str) -> int:
        rng = self.random
        if name.endswith("_ns"):
            return self._time_ns()
        low = int(schema.get("minimum", -(2**63)))
        high = int(schema.get("maximum", schema.get("exclusiveMaximum", 2**63) - 1))
        return min(max(rng.choice((low, high, 0, 1, 2**31, 2**53 + 1, rng.randrange(100_000))), low), high)

    def _boolean(self, schema: Mapping[str, Any], root: Any, name: str) -> bool:
        return self.random.random() < 0.5

    def _null(self, schema: Mapping[str, Any], root: Any, name: str) -> None:
        return None

    def _string(self, schema: Mapping[str, Any], root: Any, name: str) -> str:
        rng = self.random
        if name == "law":
            return rng.choice((*LAWS, "a" * 32))
        word = re.fullmatch(r"\^\[A-Za-z0-9_-\]\{1,(\d+)\}\$", schema.get("pattern", ""))
        if name == "id" or word:
            return "".join(rng.choices(string.ascii_letters + "_-", k=rng.choice((1, 8, int(word[1]) if word else 64))))
        if name == "src":
            return "fuzz@slave"
        if schema.get("pattern") == "^[a-z][a-z0-9_]{0,31}$":
            # Packages add programs with other names.
            return rng.choice(("scan", "z", "p" + 31 * "_"))
        if "[0-9a-f]{64}" in schema.get("pattern", ""):
            return f"{rng.getrandbits(256):064x}"
        most = schema.get("maxLength", 4096)
        texts = ("", " ", "x" * most, "Å力🔬"[:most], "\0\n\x1b[2J"[:most], "session.mcap"[:most])
        return rng.choice([text for text in texts if len(text) >= schema.get("minLength", 0)])

    def _object_of(self, part: Mapping[str, Any], root: Any) -> dict[str, Any]:
        rng = self.random
        count = rng.choice((0, 1, 2, 3)) if rng.random() < 0.995 else 1024
        names = ("path", "state", "rate", "mode", "force_n", "x" * 200, "", *(f"k{n}" for n in range(1024)))
        return {names[n]: self._value(part, root) for n in rng.sample(range(len(names)), count)}

    def _array(self, schema: Mapping[str, Any] | None = None, root: Any = None, name: str = "") -> Any:
        rng = self.random
        if schema is None:
            kind = rng.choice(("f8", "u1", "i2", "i4", "i8", "f4"))
            elements = (
                np.zeros(rng.choice((0, 1, 7, 100))) if kind[0] != "f" else np.full(rng.choice((0, 1, 100)), 10.0)
            )
            return fields_of(Array.from_numpy(elements.astype(kind)))
        if "prefixItems" in schema:
            return [self._value(item, root) for item in schema["prefixItems"]]
        count = rng.choice((0, 1, 2, 30)) if rng.random() < 0.998 else 1024
        return [self._value(schema["items"], root) for _ in range(min(count, schema.get("maxItems", count)))]

    # --- frames that they do not allow ---

    def broken(self, topic: str) -> tuple[bytes, ...]:
        """Return frames that are mostly invalid: changed, cut, spliced, with a key twice, wrong types, or bombs."""
        rng = self.random
        payload = rng.choice(self._valid[topic]) if rng.random() < 0.5 else self.extreme(topic)
        way = rng.random()
        if way < 0.4:
            payload = self._bytes_changed(payload)
        elif way < 0.6:
            payload = self._field_changed(payload)
        elif way < 0.7:
            payload = payload[: rng.randrange(len(payload) + 1)]
        elif way < 0.8:
            other = rng.choice(self._valid[rng.choice(list(TOPICS))])
            payload = payload[: rng.randrange(len(payload))] + other[rng.randrange(len(other)) :]
        elif way < 0.9:
            payload = self._doubled(payload)
        elif way < 0.98:
            payload = rng.randbytes(rng.choice((0, 1, 10, 300)))
        elif way < 0.995:
            payload = self._bomb(rng.choice((100, 4000, 20_000)))
        else:
            frames = [topic.encode(), *([payload] * rng.choice((0, 2, 5)))]
            return tuple(frames) if rng.random() < 0.5 else (rng.randbytes(8), payload)
        return topic.encode(), payload

    def _bytes_changed(self, payload: bytes) -> bytes:
        rng, changed = self.random, bytearray(payload)
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(changed) + 1)
            changed[at : at + rng.randrange(3)] = rng.randbytes(rng.randrange(3))
        return bytes(changed)

    def _field_changed(self, payload: bytes) -> bytes:
        rng = self.random
        fields = msgpack.unpackb(payload)
        key = rng.choice(list(fields))
        values: Sequence[Any] = (
            None, True, -1, 2**64 - 1, math.nan, math.inf, 1e308, -1e308, "x", b"raw", [], [1.0, 2.0, 1e308], {},
            {"a": {}}, [[[]]], {"dtype": "f8", "shape": [2**24], "data": b""}, msgpack.Timestamp(1, 0),
        )  # fmt: skip
        fields[key if rng.random() < 0.9 else "unknown_key"] = rng.choice(values)
        if rng.random() < 0.1:
            del fields[key]
        changed: bytes = msgpack.packb(fields)
        return changed

    def _doubled(self, payload: bytes) -> bytes:
        rng = self.random
        pairs = list(msgpack.unpackb(payload).items())
        changed: bytes = msgpack.Packer().pack_map_pairs([*pairs, rng.choice(pairs)])
        return changed

    def _bomb(self, size: int) -> bytes:
        rng = self.random
        unit = rng.choice((b"\x91", b"\x81\xa1a", b"\x80", b"\xdd\x00\x00\x10\x00", b"\xdf\x00\x00\x04\x00", b"\xc0"))
        return b"\x82\xaaparameters\xdc\x04\x00" + unit * (size // len(unit))


def stream(frames: Frames, topics: Sequence[str], count: int) -> Iterator[tuple[bytes, ...]]:
    """Yield `count` extreme messages and `count` broken ones alternately, on the topics in turn."""
    for number in range(count):
        topic = topics[number % len(topics)]
        yield topic.encode(), frames.extreme(topic)
        yield frames.broken(topic)
