"""A client written from proto/SPEC.md alone: what a program in another language does, without a line of ours."""

import json
import math
import os
import re
import struct
import time
from pathlib import Path
from typing import Any

import msgpack
import yaml
import zmq

CONTRACT = Path(__file__).parents[3] / "proto"
_ELEMENT = {"u1": "B", "i2": "h", "i4": "i", "i8": "q", "f4": "f", "f8": "d"}
_TYPES = {
    "null": lambda v: v is None,
    "boolean": lambda v: isinstance(v, bool),
    "integer": lambda v: isinstance(v, int) and not isinstance(v, bool),
    "number": lambda v: isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v),
    "string": lambda v: isinstance(v, str),
    "array": lambda v: isinstance(v, list),
    "object": lambda v: isinstance(v, dict),
}


def read(frames: list[bytes]) -> tuple[str, dict[str, Any]]:
    """Give topic and fields; data arrays become nested lists of numbers."""
    topic, payload = frames
    fields = msgpack.unpackb(payload)
    return topic.decode("utf-8"), {key: _with_elements(value) for key, value in fields.items()}


def write(topic: str, **fields: Any) -> list[bytes]:
    """Give the frames of a message."""
    return [topic.encode("utf-8"), msgpack.packb(fields)]


def command(seq: int, identifier: str, name: str, target: str, **parameters: Any) -> list[bytes]:
    """Give the frames of a session/control from the console."""
    return write(
        "session/control",
        **{"seq": seq, "t_ns": time.time_ns(), "src": "console@master", "v": 1},
        **{"id": identifier, "command": name, "target": target, "parameters": parameters},
    )


def endpoint(site_file: Path, node: str, reader: str) -> tuple[str, str]:
    """Give the endpoint at which a machine reads a node, and the machine of the node."""
    site = yaml.safe_load(site_file.read_text(encoding="utf-8"))
    entry = site["nodes"][node]
    if isinstance(entry, str):
        entry = {"network" if entry.startswith("tcp://") else "local": entry}
    name, _, at = node.partition("@")
    machine = entry.get("machine", "master" if name == "delay_node" else at)
    if "local" in entry and (machine == reader or "network" not in entry):
        return entry["local"].replace("{runtime}", os.environ["TELENANO_RUNTIME_DIR"]), machine
    machines = site.get("machines", {})
    addresses = {name: os.environ.get(f"TELENANO_HOST_{name.upper()}", machines[name]) for name in machines}
    return re.sub(r"\{(\w+)\}", lambda found: addresses[found.group(1)], entry["network"]), machine


def connect(socket: "zmq.Socket[bytes]", site_file: Path, node: str, keys: Path, own: str) -> None:
    """Connect to a node from a machine, with its keys where the site file wants them."""
    where, machine = endpoint(site_file, node, own)
    insecure = yaml.safe_load(site_file.read_text(encoding="utf-8")).get("insecure", False)
    if where.startswith("tcp://") and not insecure:
        pair = dict(re.findall(r'(\S+) = "([^"]*)"', (keys / f"{own}.key_secret").read_text(encoding="utf-8")))
        allowed = yaml.safe_load((keys / "allowed.yaml").read_text(encoding="utf-8"))["keys"]
        (server,) = [key["public_key"] for key in allowed if key["name"] == machine and not key["revoked"]]
        socket.setsockopt(zmq.CURVE_PUBLICKEY, pair["public-key"].encode())
        socket.setsockopt(zmq.CURVE_SECRETKEY, pair["secret-key"].encode())
        socket.setsockopt(zmq.CURVE_SERVERKEY, server.encode())
    socket.connect(where)


def schemas() -> dict[str, dict[str, Any]]:
    """Give the committed JSON Schemas by topic."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((CONTRACT / "schemas").glob("*.json"))]
    return {schema["x-topic"]: schema for schema in found}


def conforms(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> bool:
    """Return whether a value obeys a schema of the contract, by the keywords that the contract uses."""
    if "$ref" in schema:
        return conforms(value, root["$defs"][schema["$ref"].rpartition("/")[2]], root)
    if "anyOf" in schema:
        return any(conforms(value, choice, root) for choice in schema["anyOf"])
    if schema.get("format") == "binary":
        return isinstance(value, bytes)
    if not _TYPES[schema["type"]](value) or value not in schema.get("enum", [value]):
        return False
    if isinstance(value, dict):
        return _object_conforms(value, schema, root)
    if isinstance(value, list):
        items = schema.get("prefixItems") or [schema["items"]] * len(value)
        bounded = schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf)
        return bounded and all(conforms(v, s, root) for v, s in zip(value, items, strict=True))
    if isinstance(value, str):
        return len(value) <= schema.get("maxLength", math.inf) and bool(re.search(schema.get("pattern", ""), value))
    if isinstance(value, bool) or value is None:
        return True
    inside = schema.get("minimum", -math.inf) <= value <= schema.get("maximum", math.inf)
    return inside and value < schema.get("exclusiveMaximum", math.inf)


class Account:
    """The table "Sequence: gaps and restarts" for one topic and source."""

    def __init__(self) -> None:
        self.last: tuple[int, int, int | None] | None = None
        self.met: set[int] = set()
        self.missing: set[int] = set()
        self.lost = 0

    def record(self, seq: int, t_ns: int, run: int | None = None) -> str:
        """Give the row of the table that a message falls under."""
        if self.last is None:
            self.last = (seq, t_ns, run)
            return "next"
        last, last_ns, last_run = self.last
        is_another = run is not None and last_run is not None and run != last_run
        if is_another and run in self.met:
            return "overtaken"
        if is_another or (None in (run, last_run) and seq <= last and t_ns > last_ns):
            if is_another and last_run is not None:
                self.met.add(last_run)
            self.missing, self.last = set(), (seq, t_ns, run)
            return "restart"
        if seq > last:
            self.missing |= set(range(last + 1, seq))
            self.lost += seq - last - 1
            self.last = (seq, t_ns, run)
            return "next" if seq == last + 1 else "gap"
        if seq in self.missing:
            self.missing.remove(seq)
            self.lost -= 1
            return "overtaken"
        return "repetition"


def _object_conforms(value: dict[str, Any], schema: dict[str, Any], root: dict[str, Any]) -> bool:
    known, extra = schema.get("properties", {}), schema.get("additionalProperties", {})
    if not set(schema.get("required", ())) <= set(value) or len(value) > schema.get("maxProperties", math.inf):
        return False
    unknown = [key for key in value if key not in known]
    if unknown and (extra is False or (extra and not all(conforms(value[key], extra, root) for key in unknown))):
        return False
    return all(conforms(value[key], part, root) for key, part in known.items() if key in value)


def _with_elements(value: Any) -> Any:
    if isinstance(value, dict) and set(value) == {"dtype", "shape", "data"}:
        count = math.prod(value["shape"])
        elements = list(struct.unpack(f"<{count}{_ELEMENT[value['dtype']]}", value["data"]))
        for length in reversed(value["shape"][1:]):
            elements = [elements[i : i + length] for i in range(0, len(elements), length)]
        return elements
    return value
