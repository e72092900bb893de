"""Write a package that extends telenano from the templates, for `telenano new`."""

from collections.abc import Collection
from importlib.metadata import version
from importlib.resources import files
from keyword import iskeyword
from pathlib import Path
from string import Template
from typing import Literal

from telenano.files.atomic_files import whole_folder
from telenano.settings.plugins import NAME
from telenano.wire.errors import ConfigError

# The kinds of extension that a package can begin with.
Kind = Literal[
    "law", "device", "instrument", "operator", "sample", "program", "task", "command", "analysis", "export", "check",
    "package",
]  # fmt: skip
_TRY_IT: dict[Kind, str] = {
    "law": "telenano law check $name\ntelenano up fig12 --set controller.law=$name",
    "operator": "telenano up fig12 --set 'haptic_node.operator={kind: $name}'",
    "sample": "telenano up fig12 --set afm_node.environment=$name",
    "program": "telenano up image\ntelenano session set --target afm_node program=$name $name.radius_m=3e-8",
    "task": "telenano experiment new\n# and in its YAML, under tasks: {name: $name}",
    "device": "telenano up fig12 --set haptic_node.driver=$name",
    "instrument": "telenano up fig12 --set afm_node.driver=$name",
    "command": "telenano up fig12 --headless &\ntelenano $dashed --duration 2",
    "analysis": "telenano $dashed out/fig12/session.mcap",
    "export": "telenano bag export out/fig12/session.mcap --to $name --out session.$name",
    "check": "telenano doctor",
    "package": "telenano up $name",
}
# The entry points of kinds whose name is not their group: an instrument is a device of the AFM's node, an analysis is a
# command that reads recordings, and a package begins with the scenario of a laboratory.
_GROUPS = {"instrument": "devices", "analysis": "commands", "package": "scenarios"}
# A command has a module of its own, because listing it must import nothing.
_MORE_FILES = {
    "command": {"command_body.py.txt": "command.py"},
    "analysis": {"analysis_body.py.txt": "command.py"},
    "package": {"package.yaml.txt": "$name.yaml"},
}


def _taken(kind: Kind) -> Collection[str]:
    # Imported here, because no other command of this module needs the models.
    if kind == "law":
        from telenano.sections.controller_section import TAKEN as TAKEN_LAWS

        return TAKEN_LAWS
    if kind == "task":
        from telenano.settings.known_packages import known_of

        return known_of("task")
    if kind == "export":
        from telenano.recording.export import FORMATS

        return FORMATS
    if kind in ("command", "analysis"):
        from telenano.cli.lazy_commands import LAZY_COMMANDS

        return LAZY_COMMANDS
    if kind == "check":
        return ()
    if kind == "package":
        from telenano.settings.included import known_scenarios

        return known_scenarios()
    from telenano.sections.afm_section import TAKEN as TAKEN_AFM

    if kind == "sample":
        return TAKEN_AFM
    from telenano.sections.hand_section import TAKEN as TAKEN_HAPTIC
    from telenano.sections.operator_kinds import OWN_OPERATORS

    return TAKEN_HAPTIC | TAKEN_AFM if kind in ("device", "instrument") else OWN_OPERATORS


def new_package(kind: Kind, name: str, folder: Path) -> list[Path]:
    """Write a package with an extension of the given kind and a test of it; return its files.

    Raises:
        ConfigError: The name cannot be that of a package, or is taken, or the folder exists.
    """
    if not NAME.fullmatch(name) or iskeyword(name):
        raise ConfigError(f"{name}: a name has lower-case letters, digits and _, begins with a letter, at most 32")
    if name in _taken(kind):
        raise ConfigError(f"{name}: is a name of telenano's own; take another for a {kind} of yours")
    if folder.exists():
        raise ConfigError(f"{folder}: exists already; give another name or --out")
    words = {
        "kind": "scenario" if kind == "package" else kind,
        "group": _GROUPS.get(kind, f"{kind}s"),
        "name": name,
        "dashed": name.replace("_", "-"),
        "constant": name.upper(),
        "release": ".".join(version("telenano").split(".")[:2]),
    }
    words["try_it"] = Template(_TRY_IT[kind]).substitute(words)
    targets = {
        "pyproject.toml.txt": Path("pyproject.toml"),
        "README.md.txt": Path("README.md"),
        f"{kind}.py.txt": Path(f"telenano_{name}") / "__init__.py",
        f"test_{kind}.py.txt": Path("tests") / f"test_{name}.py",
    }
    for template, file in _MORE_FILES.get(kind, {}).items():
        targets[template] = Path(f"telenano_{name}") / Template(file).substitute(words)
    templates = files("telenano") / "templates"
    with whole_folder(folder) as made:
        for template, path in targets.items():
            (made / path).parent.mkdir(parents=True, exist_ok=True)
            text = Template((templates / template).read_text(encoding="utf-8")).substitute(words)
            (made / path).write_text(text, encoding="utf-8")
    return [folder / path for path in targets.values()]
