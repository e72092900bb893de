"""The page docs/scenarios.md, made from the models of the settings."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from telenano.launcher.scenario_keys import Key, all_keys

PAGE = Path(__file__).parents[2] / "docs" / "scenarios.md"
# A key that at least this many sibling sections have, with the same text, is described in one line.
SHARED = 2
_LONGEST_DEFAULT = 40
_HEAD = """# Every key of a scenario

*Generated from the settings by `make regenerate`; for whoever looks up a key, its range and its default.*

A scenario is a YAML file with one section for each node. A key that it does not name has the default below, which
stands in brackets with the range or the choices that are allowed; without a default it has no value. `--set KEY=VALUE`
changes a key for one session, `telenano scenario check FILE` checks a file, and `telenano param get` prints one
with everything in it. Quantities are in SI units. A line with `*` holds for the sections that it names at its end.
"""


def page() -> str:
    """Return the keys of the core as Markdown, each described once."""
    sections: dict[str, list[Key]] = {}
    for key in all_keys():
        sections.setdefault(key.name.partition(".")[0] if "." in key.name else "the experiment", []).append(key)
    parts = [_HEAD]
    for section, keys in sections.items():
        rest, twins = _without_twins(keys)
        parts.append(f"\n## {section}\n")
        parts += [f"{line}." for line in _merged(_shared(rest))]
        parts += [f"- `{one}.*`: the same keys as `{other}`." for one, other in twins.items()]
    return "\n".join(parts) + "\n"


def _without_twins(keys: list[Key]) -> tuple[list[Key], dict[str, str]]:
    """Return the keys without groups that repeat an earlier one, and the names of both groups."""
    groups: dict[str, list[tuple[Any, ...]]] = {}
    for key in keys:
        head, _, tail = key.name.partition(".")
        group, _, leaf = tail.partition(".")
        if leaf:
            groups.setdefault(f"{head}.{group}", []).append((leaf, *key[1:]))
    twins: dict[str, str] = {}
    for name, group in groups.items():
        same = next((other for other in groups if groups[other] == group), name)
        if same != name:
            twins[name] = same
    return [key for key in keys if ".".join(key.name.split(".")[:2]) not in twins], twins


def _shared(keys: list[Key]) -> list[tuple[str, str]]:
    """Return name and text of each key; one line for a key that several sibling sections have."""
    alike: dict[tuple[str, str, str], list[str]] = {}
    for key in keys:
        above, own, leaf = _split(key.name)
        alike.setdefault((above, leaf, _about(key)), []).append(own)
    found = []
    for key in keys:
        above, own, leaf = _split(key.name)
        owners = alike[above, leaf, _about(key)]
        if not own or len(owners) < SHARED:
            found.append((key.name, _about(key)))
        elif own == owners[0]:
            found.append((f"{above}.*.{leaf}", f"{_about(key)} ({', '.join(owners)})"))
    return found


def _split(name: str) -> tuple[str, str, str]:
    above, _, leaf = name.rpartition(".")
    above, _, own = above.rpartition(".")
    return above, own, leaf


def _merged(lines: list[tuple[str, str]]) -> Iterable[str]:
    """Yield one line for successive keys of a section with the same text."""
    names: list[str] = []
    for number, (name, about) in enumerate(lines):
        names.append(f"`{name}`" if not names else f"`{name.rpartition('.')[2]}`")
        following = lines[number + 1] if number + 1 < len(lines) else ("", "")
        if following[1] != about or following[0].rpartition(".")[0] != name.rpartition(".")[0]:
            yield f"- {', '.join(names)}{about}"
            names = []


def _about(key: Key) -> str:
    text = " ".join(key.about.split()).removesuffix(".").replace("*", "\\*")
    choices = key.kind.split(", ") if ", " in key.kind and " " not in key.kind.replace(", ", "") else []
    if key.least is not None or key.most is not None:
        least, most = ("" if bound is None else f"{bound:g}" for bound in (key.least, key.most))
        allowed = f"{least}…{most}"
    else:
        # Choices that the text explains one by one are not listed before it.
        allowed = "" if all(f"{choice}:" in text for choice in choices) else "|".join(choices)
    given = ", ".join(part for part in (_default(key.default), allowed) if part)
    return f" ({given}): {text}" if given else f": {text}"


def _default(default: Any) -> str:
    if default is None:
        return ""
    text = f"{default:g}" if isinstance(default, float) else str(default)
    return text if len(text) <= _LONGEST_DEFAULT else "a list or section"
