"""What a client in another language relies on: bounds that survive doubles, who sends what, keys made elsewhere."""

import json
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
import yaml
import zmq
from typer.testing import CliRunner
from wire_contract import FOLDER

from telenano.cli.root import app
from telenano.runtime.bus.address_book import AddressBook
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire.nodes import LINK, name_of, site_of
from telenano.wire.topics import OWN_TOPICS as TOPICS

SCHEMAS = {path.stem: json.loads(path.read_text()) for path in sorted((FOLDER / "schemas").glob("*.json"))}
VECTORS = json.loads((FOLDER / "golden" / "vectors.json").read_text())


def integers(value: Any, schema: Any, root: Any) -> Iterator[tuple[int, Any]]:
    """Return each integer of a message, with its part of the schema."""
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    for choice in schema.get("anyOf", ()):
        if isinstance(value, int) and choice.get("type") == "integer":
            yield value, choice
    if isinstance(value, dict):
        for key, part in value.items():
            yield from integers(part, schema.get("properties", {}).get(key, {}), root)
    elif isinstance(value, list):
        items = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
        for part, kind in zip(value, items, strict=True):
            yield from integers(part, kind, root)
    elif isinstance(value, int) and schema.get("type") == "integer":
        yield value, schema


def test_a_validator_that_keeps_numbers_as_doubles_takes_every_golden_vector() -> None:
    seen = 0
    for vector in VECTORS:
        root = SCHEMAS[vector["message"]]
        for value, schema in integers(vector["fields"], root, root):
            seen += 1
            assert float(value) <= float(schema.get("maximum", 2**63)), (vector["topic"], vector["case"], value)
            assert float(value) < float(schema.get("exclusiveMaximum", 2**64)), (vector["topic"], vector["case"], value)
    assert seen > 1000


@pytest.mark.parametrize("name", SCHEMAS)
def test_no_bound_of_64_bits_is_exclusive(name: str) -> None:
    assert "9223372036854775808" not in json.dumps(SCHEMAS[name]).replace("-9223372036854775808", "")


def table_of_topics() -> dict[str, tuple[list[str], str]]:
    """Return who publishes each topic, and which way it crosses the link, by the table of SPEC.md."""
    text = (FOLDER / "SPEC.md").read_text().partition("<!-- topics: ")[2].partition("<!-- end of topics")[0]
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| `")]
    return {row[0].strip("`"): ([part.strip("` ") for part in row[2].split(",")], row[7]) for row in rows}


def test_the_table_of_topics_says_what_the_address_book_subscribes_to() -> None:
    book, table = AddressBook.load(DEFAULT_SITE_FILE), table_of_topics()
    assert set(table) == set(TOPICS)
    for node in book.nodes:
        own = {
            topic
            for topic, (senders, _) in table.items()
            if any(fnmatchcase(node, name) or fnmatchcase(name_of(node), name) for name in senders)
        }
        towards = "forward" if site_of(node) == "slave" else "backward"
        forwarded = {topic for topic, (_, way) in table.items() if name_of(node) == LINK and way in (towards, "both")}
        everywhere = {topic for topic, (senders, _) in table.items() if senders == ["every node"]}
        # packages add topics that other tests of this process may have named
        assert set(book.published_by(node)) & set(table) == own | forwarded | everywhere


def test_a_pair_of_keys_from_libzmq_alone_is_allowed(tmp_path: Path) -> None:
    public, _ = (part.decode() for part in zmq.curve_keypair())
    # One key in 85 of libzmq begins with a hyphen, as an option does.
    arguments = ["keys", "allow", "--role", "observe", "--dir", str(tmp_path), "--", "unity", public]
    tmp_path.chmod(0o700)
    assert CliRunner().invoke(app, arguments).exit_code == 0
    [row] = yaml.safe_load((tmp_path / "allowed.yaml").read_text())["keys"]
    assert (row["name"], row["public_key"], row["roles"]) == ("unity", public, ["observe"])
