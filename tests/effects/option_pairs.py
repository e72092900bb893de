"""Pairs of options of a command: what is seen when both are given, and what of that breaks a promise.

    faults = faults_of(command, first, second, folder)

A pair is run in virtual time or to its refusal. No pair may end with a traceback or with a code that is not promised,
`--json` has one object beside any other option, what a rule of the command calls void is refused, and an option that
acts alone acts beside another one, or is refused with it.
"""

import functools
import json
import zlib
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from option_effects import COMMANDS, WITHOUT, Seen, commands, filled, ready, run, values_of

from telenano.cli.option_rules import Void, name_of, rules_of

# The codes that docs/cli.md promises of a command that no signal ends.
CODES = (0, 1, 2, 3)
REFUSED = 2
# Commands of a rig, which has none here, to their refusal: what their options do is not seen.
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
    "link profile": "link profile",
    "link clear": "link clear",
    "link probe": "link probe --out {out}/made",
    "law by-line": "law by-line --scenario fig12",
    "record": "record --out {out}/made.mcap --duration 0",
    "replay": "replay {demo} --rate 0 --end 0.1 --wait 0",
    "bag fetch": "bag fetch {folder}",
    "device monitor": "device monitor --device haply",
    "view": "view --certificate none.pem --key none.pem",
}
WORDS: Mapping[str, str] = {**TO_A_RIG, **COMMANDS}
# Options that let a command wait for a person, by command.
ENDLESS = ("replay --loop", "replay --paused")
# Options that do nothing beside another one because that does what they ask for, by command and pair, with the reason.
IMPLIED: Mapping[str, str] = {}


def pairs() -> Iterator[tuple[str, Any, Any]]:
    """Yield each pair of options of each command."""
    for name, command in commands():
        if name in WORDS:
            options = options_of(name, command)
            yield from ((name, one, other) for at, one in enumerate(options) for other in options[at + 1 :])


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


@functools.lru_cache(maxsize=100)
def alone(command: str, options: tuple[Any, ...], folder: Path) -> tuple[dict[str, Any], frozenset[str]]:
    """Return what a command leaves, with an option or none, and the names of what is the same in a second run."""
    words = words_with(command, options, folder)
    first, second = (dict(seen_of(command, words, folder).items()) for _ in range(2))
    return first, frozenset(name for name in first if first[name] == second.get(name))


def differs(before: tuple[dict[str, Any], frozenset[str]], now: Mapping[str, Any]) -> bool:
    """Return whether something that two runs have alike is another now."""
    first, stable = before
    return any(now.get(name) != first[name] for name in stable)


def faults_of(command: str, one: Any, other: Any, folder: Path) -> list[str]:
    """Return the promises that a pair of options breaks, each as a sentence."""
    words = words_with(command, (one, other), folder)
    pair = f"{command} {one.opts[0]} {other.opts[0]}"
    seen = seen_of(command, words, folder)
    faults = [] if seen.code in CODES else [f"{' '.join(words)}: code {seen.code}"]
    typed = dict(commands())[command]
    with_json = words if "--json" in words else [*words, "--json"]
    # Half of the pairs are run again for their object.
    has_json = any("--json" in option.opts for option in typed.params)
    if has_json and (with_json == words or zlib.crc32(pair.encode()) % 2):
        as_json = seen if with_json == words else seen_of(command, with_json, folder)
        faults += [] if is_one_object(as_json) else [f"{' '.join(with_json)}: {as_json.lines[:3]} is not one object"]
    if (void := [row for row in rules_of(typed) if isinstance(row, Void) and is_void(row, typed, words)]) and (
        seen.code != REFUSED
    ):
        faults.append(f"{' '.join(words)}: {void[0].options} is void and not refused")
    elif command in COMMANDS and seen.code != REFUSED and pair not in IMPLIED:
        now, base = dict(seen.items()), alone(command, (), folder)
        for idle, acting in ((one, other), (other, one)):
            if {idle.opts[0], f"{command} {idle.opts[0]}"} & WITHOUT.keys():
                continue
            by_itself, beside = alone(command, (idle,), folder), alone(command, (acting,), folder)
            if by_itself[0]["exit code"] != REFUSED and differs(base, by_itself[0]) and not differs(beside, now):
                faults.append(f"{' '.join(words)}: {idle.opts[0]} does nothing beside {acting.opts[0]}")
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
