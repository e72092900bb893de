"""What others rely on: names, options, extras, entry points, keys of scenarios and of summaries, topics and exit codes.

`python tests/contract/public_surface.py` writes what there is now into `public_surface.json`. The rule for what may go
is in docs/release.md: before the first release a name leaves that file with a line in CHANGELOG.md.
"""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from public_names import offered

from telenano.cli import exit_codes
from telenano.cli.lazy_commands import LAZY_COMMANDS, load
from telenano.settings.included import SCHEMA_DIRECTORY
from telenano.settings.plugins import KINDS
from telenano.wire.topics import OWN_TOPICS as TOPICS

FILE = Path(__file__).with_suffix(".json")
ROOT = Path(__file__).parents[2]


def surface() -> dict[str, list[str]]:
    """Return the names of each kind, sorted."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found = {
        "python": [f"{module}.{name}" for module, names in offered().items() for name in names],
        "options": [flag for name in LAZY_COMMANDS for flag in options(f"telenano {name}", load(name))],
        "extras": settings["optional-dependencies"],
        "entry points": [f"telenano.{kind}" for kind in KINDS],
        "scenario keys": keys_of("scenario.json"),
        "summary keys": keys_of("summary.json"),
        "topics": [f"{name} v{topic.model.version}" for name, topic in TOPICS.items()],
        "exit codes": [f"{name} = {code}" for name, code in vars(exit_codes).items() if name.startswith("EXIT_")],
    }
    return {kind: sorted(set(names)) for kind, names in found.items()}


def options(path: str, command: Any) -> Iterator[str]:
    """Yield `telenano bag info --full` for each option, and the command alone."""
    yield path
    for name, below in getattr(command, "commands", {}).items():
        yield from options(f"{path} {name}", below)
    for parameter in command.params:
        yield from (f"{path} {flag}" for flag in parameter.opts if flag.startswith("-"))


def keys_of(file: str) -> list[str]:
    """Return the keys of a JSON Schema of the project, those of parts with a dot."""
    schema = json.loads((SCHEMA_DIRECTORY / file).read_text(encoding="utf-8"))
    return list(_keys(schema, schema, "", ()))


def _keys(schema: dict[str, Any], part: dict[str, Any], before: str, within: tuple[str, ...]) -> Iterator[str]:
    reference = part.get("$ref", "")
    if reference in within:
        return
    if reference:
        part, within = schema["$defs"][reference.rpartition("/")[2]], (*within, reference)
    items = part.get("items")
    for other in (*part.get("anyOf", ()), *part.get("oneOf", ()), *([items] if isinstance(items, dict) else [])):
        yield from _keys(schema, other, before, within)
    for name, below in part.get("properties", {}).items():
        yield f"{before}{name}"
        yield from _keys(schema, below, f"{before}{name}.", within)


if __name__ == "__main__":
    FILE.write_text(json.dumps(surface(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
