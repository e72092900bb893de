"""Pairs of options of a command: what is seen when both are given, and what of that breaks a promise.

    faults = faults_of(command, first, second, folder)

A pair is run in virtual time or to its refusal. No pair may end with a traceback or with a code that is not promised,
`--json` has one object beside any other option, and what a rule of the command calls void is refused.
"""

import functools
import json
import zlib
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from option_effects import COMMANDS, Seen, commands, filled, ready, run, values_of

from telenano.cli.option_rules import Void, name_of, rules_of

# The codes that docs/cli.md promises of a command that no signal ends.
CODES = (0, 1, 2, 3)
REFUSED = 2
# Commands of a rig, of which there is none here, to their refusal.
TO_A_RIG: Mapping[str, str] = {
    "up": "up fig12 --out {out}/made",
    "session": "session mark",
    "estop": "estop",
    "status": "status",
    "topic list": "topic list",
    "topic echo": "topic echo afm/state",
    "topic hz": "topic hz afm/state",
    "link show": "link show",
    "link set": "link set forward.delay_s=0.01",
    "link clear": "link clear",
    "link probe": "link probe --out {out}/made",
    "law by-line": "law by-line --scenario fig12 --duration 0",
    "record": "record --out {out}/made.mcap --duration 0",
    "replay": "replay {demo} --rate 0 --end 0.1 --wait 0",
    "bag fetch": "bag fetch {folder}",
    "device monitor": "device monitor --device haply",
    "view": "view --certificate none.pem --key none.pem",
}
WORDS: Mapping[str, str] = {**TO_A_RIG, **COMMANDS}
# Options that let a command wait for a person, or start rigs of real processes, by command.
ENDLESS = ("replay --loop", "replay --paused", "experiment run --apparatus")


def pairs() -> Iterator[tuple[str, Any, Any]]:
    """Yield each pair of options of each command."""
    for name, command in every_command().items():
        if name in WORDS:
            options = options_of(name, command)
            yield from ((name, one, other) for at, one in enumerate(options) for other in options[at + 1 :])


@functools.cache
def every_command() -> dict[str, Any]:
    """Return each command by its name."""
    return dict(commands())


def options_of(name: str, command: Any) -> list[Any]:
    """Return the options of a command that are tried."""
    return [
        option
        for option in command.params
        if option.param_type_name == "option" and not option.hidden and f"{name} {option.opts[0]}" not in ENDLESS
    ]


def words_with(command: str, options: tuple[Any, ...], folder: Path) -> list[str]:
    """Return the words of a command with a sound value of each option, instead of that which it has already."""
    words = filled(WORDS[command], folder)
    for option in options:
        value = [filled(word, folder)[0] if "{" in word else word for word in values_of(command, option)[0]]
        if value[0] in words:
            place = words.index(value[0])
            words = [*words[:place], *words[place + 1 + (0 if option.is_flag else option.nargs) :]]
        words += value
    return words


def seen_of(command: str, words: list[str], folder: Path) -> Seen:
    """Run a command as it is found, with what its words need made ready."""
    return run(words, folder / "out", ready(command, "", folder) if command in COMMANDS else lambda: None)


def faults_of(command: str, one: Any, other: Any, folder: Path) -> list[str]:
    """Return the promises that a pair of options breaks, each as a sentence."""
    words = words_with(command, (one, other), folder)
    seen = seen_of(command, words, folder)
    faults = [] if seen.code in CODES else [f"{' '.join(words)}: code {seen.code}"]
    typed = every_command()[command]
    void = [row for row in rules_of(typed) if isinstance(row, Void) and is_void(row, typed, words)]
    if void and seen.code != REFUSED:
        faults.append(f"{' '.join(words)}: {void[0].options} is void and not refused")
    if "--json" not in words and any("--json" in option.opts for option in typed.params):
        # Half of the pairs are run again for their object.
        if zlib.crc32(f"{command} {one.opts[0]} {other.opts[0]}".encode()) % 2:
            return faults
        words = [*words, "--json"]
        seen = seen_of(command, words, folder)
    if "--json" in words and not is_one_object(seen):
        faults.append(f"{' '.join(words)}: {seen.lines[:3]} is not one object")
    return faults


def is_one_object(seen: Seen) -> bool:
    """Return whether a command has printed one JSON object and nothing else."""
    try:
        return len(seen.lines) == 1 and isinstance(json.loads(seen.lines[0]), dict)
    except ValueError:
        return False


def is_void(row: Void, command: Any, words: list[str]) -> bool:
    """Return whether a rule calls an option void that stands among words; rules on arguments are not looked at."""
    options = {flag: one for one in command.params if one.param_type_name == "option" for flag in one.opts}
    given = {
        name_of(options[word]): words[place + 1] if not options[word].is_flag else ""
        for place, word in enumerate(words)
        if word in options
    }

    def has(terms: str) -> bool:
        split = [term.strip().partition(" ") for term in terms.split(",") if term.strip()]
        return any(name in given and fnmatchcase(given[name], value or "*") for name, _, value in split)

    if row.options == "*":
        kept = {term.strip() for term in f"{row.but},{row.beside}".split(",")}
        return has(row.beside) and bool(given.keys() - kept)
    named = f"{row.beside},{row.unless}"
    if any(not term.strip().startswith("--") for term in named.split(",") if term.strip()):
        return False
    return has(row.options) and (has(row.beside) or not row.beside) and not has(row.unless)
