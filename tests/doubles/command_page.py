"""The list of commands in docs/cli.md, made from their options."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import typer

from telenano.cli.lazy_commands import LAZY_COMMANDS, load
from telenano.cli.root import app

PAGE = Path(__file__).parents[2] / "docs" / "cli.md"
START, END = "<!-- commands: written by make regenerate -->\n", "<!-- end of commands -->\n"
# An option that at least this many commands have, with the same text except for its default, is described once.
SHARED = 2
# The range of an option in its text, which only `--help` shows.
_RANGE = re.compile(r"; (?:above )?[-0-9.e+]+ (?:to (?:below )?[-0-9.e+]+|or more)$")
# Text that typer adds to the text of an option.
_ADDED = re.compile(r"\s*\[(?:default: ([^];]*)[^]]*|[^]]*[<>]=[^]]*|required)\]$")


def commands() -> dict[str, Any]:
    """Return the commands of the core by their words, including groups; packages describe their own."""
    found = dict([next(_with_inner(typer.main.get_command(app), "telenano"))])
    for name in LAZY_COMMANDS:
        found.update(_with_inner(load(name), f"telenano {name}"))
    return found


def groups(found: dict[str, Any]) -> set[str]:
    """Return the words of groups, after which another word must follow."""
    return {
        path
        for path, command in found.items()
        if getattr(command, "commands", None) is not None and not command.invoke_without_command and len(path) > 8
    }


def page() -> str:
    """Return the list in Markdown."""
    found = commands()
    for path in groups(found):
        del found[path]
    written = {path: [_line(command, option) for option in options(command)] for path, command in found.items()}
    times = Counter(about for lines in written.values() for about, _ in lines)
    # The rarer first, so that of two texts of one option the more frequent one is kept.
    often = {_flag(about): about for about, count in reversed(times.most_common()) if count >= SHARED}
    defaults = {about: _most(written.values(), about) for about in often.values()}
    shared = sorted(defaults)
    parts = ["## Options of several commands\n", *(f"{about}{_default(defaults[about])}." for about in shared)]
    for path, command in found.items():
        parts.append(f"\n## {' '.join([path, *_arguments(command)])}\n\n{_about(command)}")
        if own := [f"{about}{_default(default)}." for about, default in written[path] if about not in shared]:
            parts += ["", *own]
        if known := [
            f"`{_flag(about)}`{'' if default == defaults[about] else _default(default)}"
            for about, default in written[path]
            if about in shared
        ]:
            parts.append(f"{'' if own else chr(10)}- and {', '.join(known)}")
    return "\n".join(parts) + "\n"


def options(command: Any) -> list[Any]:
    """Return the options of a command, in the order of its help."""
    return [one for one in command.params if one.param_type_name == "option" and one.name != "help"]


def with_page(text: str) -> str:
    """Return docs/cli.md with the list in its place."""
    head, _, rest = text.partition(START)
    _, end, tail = rest.partition(END)
    assert end, f"cli.md needs the lines {START!r} and {END!r}"
    return f"{head}{START}\n{page()}\n{end}{tail}"


def _with_inner(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    yield path, command
    for name, child in (getattr(command, "commands", None) or {}).items():
        yield from _with_inner(child, f"{path} {name}")


def _about(command: Any) -> str:
    return "\n\n".join(" ".join(part.split()) for part in (command.help or "").split("\n\n"))


def _arguments(command: Any) -> list[str]:
    return [_named(one) + ("..." if one.nargs == -1 else "") for one in command.params if one not in options(command)]


def _named(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    return name if argument.required else f"[{name}]"


def _flags(command: Any, option: Any) -> str:
    flags, _ = option.get_help_record(_context(command))
    return re.sub(r"[<>]", "", flags.split(", ")[-1])


def _line(command: Any, option: Any) -> tuple[str, str]:
    """Return an option with its text, and separately its default."""
    _, text = option.get_help_record(_context(command))
    added, about = _ADDED.search(text), _ADDED.sub("", text)
    about, _, default = about.removesuffix(".").rpartition("; default: ") if "; default: " in about else (about, "", "")
    about = _RANGE.sub("", about.removesuffix("."))
    needed = " (required)" if option.required else ""
    return f"- `{_flags(command, option)}`{needed}: {about}", default or (added[1] if added else None) or ""


def _most(written: Iterable[list[tuple[str, str]]], about: str) -> str:
    """Return the default that an option has most often, given its text."""
    return Counter(default for lines in written for text, default in lines if text == about).most_common(1)[0][0]


def _default(default: str) -> str:
    return f" (default: {default})" if default else ""


def _flag(line: str) -> str:
    return line.split("`")[1].split()[0]


def _context(command: Any) -> Any:
    return typer.Context(command, info_name=command.name or "telenano")
