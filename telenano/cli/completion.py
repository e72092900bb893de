"""Shell completion of values, besides commands and options. The module imports nothing that takes time."""

from typing import Any


def scenario_names(incomplete: str) -> list[str]:
    """Return the known scenarios whose names begin with the text."""
    from telenano.settings.included import known_scenarios

    return [name for name in known_scenarios() if name.startswith(incomplete)]


def scenario_sections(incomplete: str) -> list[str]:
    """Return the sections of a scenario whose names begin with the text."""
    from telenano.wire.nodes import SERVICES

    return [name for name in SERVICES if name.startswith(incomplete)]


def scenario_keys(incomplete: str) -> list[str]:
    """Return completions of `SECTION.KEY=VALUE`: a section with its dot, a key with its `=`, or a value of a choice."""
    import json

    from telenano.settings.included import SCHEMA_DIRECTORY

    schema = json.loads((SCHEMA_DIRECTORY / "scenario.json").read_text(encoding="utf-8"))
    key, sign, value = incomplete.partition("=")
    names, last = key.split(".")[:-1], key.split(".")[-1]
    choices = _properties(schema, schema)
    for name in names:
        choices = _properties(schema, choices.get(name, {}))
    if sign:
        texts = [text for part in _alternatives(schema, choices.get(last, {})) for text in _values(part)]
        return [f"{key}={text}" for text in texts if text.startswith(value)]
    before = "".join(f"{name}." for name in names)
    return [
        f"{before}{name}{'.' if _properties(schema, part) else '='}"
        for name, part in choices.items()
        if name.startswith(last) and (names or _properties(schema, part))
    ]


def _properties(schema: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a part of a JSON Schema and of its alternatives, by their names."""
    return {
        name: schema_of_key
        for one in _alternatives(schema, part)
        for name, schema_of_key in one.get("properties", {}).items()
    }


def _alternatives(schema: dict[str, Any], part: dict[str, Any]) -> list[dict[str, Any]]:
    if "$ref" in part:
        part = schema["$defs"][part["$ref"].rpartition("/")[2]]
    several = [*part.get("anyOf", ()), *part.get("oneOf", ())]
    return [one for other in several for one in _alternatives(schema, other)] if several else [part]


def _values(part: dict[str, Any]) -> list[str]:
    if part.get("type") == "boolean":
        return ["true", "false"]
    return [str(value) for value in part.get("enum", [part["const"]] if "const" in part else [])]


def topic_names(incomplete: str) -> list[str]:
    """Return the topics whose names begin with the text, and `topic@site` for their copies that left the link."""
    from telenano.settings.package_topics import topics_by_name
    from telenano.wire import TOPICS

    names = [*TOPICS, *topics_by_name()]
    copies = {"forward": ("slave",), "backward": ("master",), "both": ("slave", "master"), None: ()}
    names += [f"{name}@{site}" for name, row in TOPICS.items() for site in copies[row.bridged]]
    return [name for name in names if name.startswith(incomplete)]


def law_names(incomplete: str) -> list[str]:
    """Return the laws whose names begin with the text, and `all`; in a list a,b,c the last part is completed."""
    before, comma, last = incomplete.rpartition(",")
    names = [*law_name(last), *(["all"] if "all".startswith(last) else [])]
    return [f"{before}{comma}{name}" for name in names]


def law_name(incomplete: str) -> list[str]:
    """Return the laws whose names begin with the text, including those of installed packages, without importing one."""
    from telenano.sections.law_names import LAW_NAMES
    from telenano.settings.plugins import installed

    return [name for name in (*LAW_NAMES, *installed("laws")) if name.startswith(incomplete)]


def service_names(incomplete: str) -> list[str]:
    """Return the arguments of `telenano node` that begin with the text: names without a site, and `list`."""
    from telenano.wire.nodes import SERVICES

    return [name for name in (*SERVICES, "list") if name.startswith(incomplete)]


def node_names(incomplete: str) -> list[str]:
    """Return the nodes of a rig whose names begin with the text, as name and as name@site."""
    from telenano.wire.nodes import START_ORDER, name_of

    return [name for name in (*dict.fromkeys(map(name_of, START_ORDER)), *START_ORDER) if name.startswith(incomplete)]
