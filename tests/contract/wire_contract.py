"""The committed form of the contract: a JSON Schema a message, golden bytes, and the topic table of SPEC.md.

The examples behind the golden bytes are made from the schemas, so that a new field gets its own.
"""

import json
from pathlib import Path
from typing import Any

import msgpack

from telenano.testing.filled_messages import CASES, examples, schema_of
from telenano.wire.codec import MOST_BYTES, encode
from telenano.wire.messages import Message
from telenano.wire.ranges import RANGES
from telenano.wire.topics import OWN_TOPICS as TOPICS

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "proto"
# These parts of SPEC.md are generated.
PARTS = ("topics", "ranges")


def vectors() -> list[dict[str, Any]]:
    """Return the golden vectors: message, topic, case, fields as JSON (bytes in hexadecimal) and the encoded bytes."""
    return [
        {
            "message": topic.model.__name__,
            "topic": topic.name,
            "case": case,
            "fields": present_fields(message),
            "hex": encode(message).hex(),
        }
        for topic in TOPICS.values()
        for case, message in examples(topic).items()
    ]


def present_fields(message: Message) -> dict[str, Any]:
    """Return the fields of a message without those that are absent."""
    fields: dict[str, Any] = msgpack.unpackb(encode(message), use_list=False)
    return fields


def topic_table() -> str:
    """Return the topic table in Markdown."""
    rows = ["| topic | message | published by | read | rate | stale after | at most | over the link | what it is |"]
    rows.append("|---" * 9 + "|")
    for topic in TOPICS.values():
        about = (topic.model.__doc__ or "").splitlines()[0].rstrip(".")
        cells = (
            f"`{topic.name}`",
            topic.model.__name__,
            ", ".join("every node" if name == "*" else f"`{name}`" for name in topic.publishers),
            topic.delivery,
            "on change" if topic.rate_hz is None else f"{topic.rate_hz:g} Hz",
            "–" if topic.deadline_s is None else f"{topic.deadline_s:g} s",
            f"{MOST_BYTES[topic.model] >> 10} KiB",
            topic.bridged or "–",
            about,
        )
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def range_table() -> str:
    """Return the table of ranges in Markdown."""
    rows = ["| quantity | from | to |", "|---" * 3 + "|"]
    for entry in RANGES:
        low, high = (f"{bound:g} {entry.unit}" for bound in (entry.low, entry.high))
        rows.append(f"| {entry.quantity} | {low} | {high} |")
    return "\n".join(rows)


def artefacts(root: Path = ROOT) -> dict[Path, str]:
    """Return every committed file of the contract, in a checkout at `root`, and the text that it should hold."""
    folder = root / "proto"
    files = {folder / "schemas" / f"{t.model.__name__}.json": _json_text(schema_of(t)) for t in TOPICS.values()}
    golden = vectors()
    files[folder / "golden" / "vectors.json"] = _json_text(golden)
    least = {vector["topic"]: vector["hex"] for vector in golden if vector["case"] == CASES[0].name}
    files[root / "telenano" / "wire" / "examples.json"] = _json_text(least)
    spec = (folder / "SPEC.md").read_text(encoding="utf-8")
    for part, table in zip(PARTS, (topic_table(), range_table()), strict=True):
        spec = _with_table(spec, part, table)
    files[folder / "SPEC.md"] = spec
    return files


def _json_text(data: Any) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False, default=bytes.hex) + "\n"


def _with_table(spec: str, part: str, table: str) -> str:
    first, last = f"<!-- {part}: written by make regenerate -->", f"<!-- end of {part} -->"
    head, start, rest = spec.partition(first)
    _, end, tail = rest.partition(last)
    if not (start and end):
        raise ValueError(f"SPEC.md needs the lines {first!r} and {last!r} around its table of {part}")
    return f"{head}{start}\n\n{table}\n\n{end}{tail}"
