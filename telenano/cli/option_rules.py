"""Rules over the options of a command: what another option makes void, and which keys are stated twice.

A command declares them as a table beside its options, and every command, also of a package, is held to them before
its function is called:

    @rules(
        Void("--table", "which compares the sessions of a sweep", unless="--sweep, --seeds"),
        Keys("--duration", "duration_s"),
    )
    def simulate(...): ...

For all commands alike but `estop`, which stops all the same, an option that is no list is given once, each key of
`KEY=VALUE` is stated once, and a path is one that can be used. What an option asks for is void if it does not happen;
an option that another one implies is not.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from telenano.cli.path_options import check_path
from telenano.wire.errors import ConfigError
from telenano.wire.printable import shown

F = TypeVar("F", bound=Callable[..., Any])

# Options and arguments whose texts state keys, such as `SECTION.KEY=VALUE` and `[TOPIC:]FIELD=VALUE`.
_STATES = re.compile(r"\S+=\S+")


class Void(NamedTuple):
    """Options that do nothing beside another one, or without it.

    In all texts options and arguments stand with commas between; an argument has the name of its metavar, and behind a
    name may stand a value, which may have `*`: `--site slave`, `COMMAND arm`, `--pattern letters:*`.

    Attributes:
        options: What is void; `*` stands for all that is given.
        reason: A clause that follows the name of the other option, such as `which starts no node`.
        beside: They are void where one of these is given; empty for always.
        unless: They are not void where one of these is given.
        but: Exceptions of `*`.
    """

    options: str
    reason: str
    beside: str = ""
    unless: str = ""
    but: str = ""


class Keys(NamedTuple):
    """An option that states keys of another option too, which are then stated once only.

    Attributes:
        option: The option.
        keys: The keys; one without a section, such as `seed`, is another name for all of them. Without keys they are in
            the texts of the option, as KEY=VALUE.
        of: The option that has these keys as well.
    """

    option: str
    keys: str = ""
    of: str = "--set"


class Given(NamedTuple):
    """What a person gave for an option or an argument, by its name, with each text."""

    name: str
    texts: Sequence[Any]
    parameter: Any

    @property
    def is_option(self) -> bool:
        return bool(self.parameter.param_type_name == "option")

    @property
    def written(self) -> list[str]:
        """Each text as it was typed."""
        if getattr(self.parameter, "is_flag", False):
            return [self.name for _ in self.texts]
        words = [" ".join(text) if isinstance(text, tuple) else text for text in self.texts]
        return [f"{self.name} {shown(word)}" if self.is_option else shown(word) for word in words]


def rules(*rows: Void | Keys) -> Callable[[F], F]:
    """Return a decorator that declares rules over the options of a command, in addition to those that it has."""

    def decorate(command: F) -> F:
        command.option_rules = (*getattr(command, "option_rules", ()), *rows)  # type: ignore[attr-defined]
        return command

    return decorate


def check_options(command: Any) -> None:
    """Make a command of typer refuse, before it begins, options that break a rule; with --json it prints one object."""
    command.parse_args = partial(_parsed, command, command.parse_args)
    command.invoke = partial(_invoked, command.invoke)


def name_of(parameter: Any) -> str:
    """Return the name by which rules and messages call an option or an argument of typer."""
    if parameter.param_type_name == "option":
        return next((name for name in parameter.opts if name.startswith("--")), str(parameter.opts[0]))
    return str(parameter.metavar or parameter.name.upper()).strip("[]")


def _parsed(command: Any, parse: Callable[..., list[str]], context: Any, args: list[str]) -> list[str]:
    given = {} if context.resilient_parsing else _given(command, context, args)
    if "--help" not in given:
        rows = rules_of(command)
        for one in given.values():
            _refuse_twice(one)
            if one.parameter.type_descriptor.annotation in (Path, list[Path]):
                for text in one.texts:
                    check_path(one.parameter, text)
        _refuse_keys(given, [row for row in rows if isinstance(row, Keys)])
        for row in rows:
            if isinstance(row, Void):
                _refuse_void(given, row)
    return parse(context, args)


def _invoked(invoke: Callable[..., Any], context: Any) -> Any:
    if not context.params.get("as_json"):
        return invoke(context)
    from telenano.cli.output import one_object

    with one_object():
        return invoke(context)


def rules_of(command: Any) -> tuple[Void | Keys, ...]:
    """Return the rules that a command of typer declares."""
    declared: tuple[Void | Keys, ...] = getattr(command.callback, "option_rules", ())
    return declared


def _given(command: Any, context: Any, args: Sequence[str]) -> dict[str, Given]:
    """Return what stands on a command line, by name; usage errors are those of the command's own parser."""
    parser, parameters = command.make_parser(context), command.get_params(context)
    for parameter in parameters:
        if parameter.param_type_name == "option":
            # The parser keeps all texts of an option that may be repeated, and only the last one of another.
            each = copy(parameter)
            each.multiple = True
            each.add_to_parser(parser, context)
    found, _, _ = parser.parse_args(args=list(args))
    given = [Given(name_of(one), _texts(one, found.get(one.name)), one) for one in parameters]
    return {one.name: one for one in given if one.texts}


def _texts(parameter: Any, found: Any) -> Sequence[Any]:
    """Return the texts of an option or argument; what is absent is None, or a mark of the library."""
    if isinstance(found, str) or (parameter.param_type_name == "argument" and parameter.nargs > 1):
        return (found,)
    return found if isinstance(found, list | tuple) else ()


def _refuse_twice(one: Given) -> None:
    if one.is_option and not one.parameter.multiple and len(one.texts) > 1:
        raise ConfigError(f"{' and '.join(one.written)}: {one.name} is given twice; give it once")


def _refuse_keys(given: Mapping[str, Given], rows: Sequence[Keys]) -> None:
    """Raise ConfigError, with both texts, for a key that is stated twice, or in a section that is stated as well."""
    of = {row.option: row for row in rows}
    stated: list[tuple[str, Sequence[str], str]] = []
    for one in given.values():
        if one.name not in of and not _STATES.fullmatch(one.parameter.metavar or ""):
            continue
        row = of.get(one.name, Keys(one.name, of=one.name))
        for text, written in zip(one.texts, one.written, strict=True):
            keys = _split(row.keys) or _meant(str(text).partition("=")[0].strip(), rows)
            for space, others, earlier in stated:
                if space == row.of and (both := next((k for k in keys for o in others if _overlap(k, o)), "")):
                    raise ConfigError(f"{earlier} and {written}: both state {shown(both)}; give one of them")
            stated.append((row.of, keys, written))


def _meant(key: str, rows: Sequence[Keys]) -> Sequence[str]:
    """Return the keys that a key of a text means: all those of a row if it is their common name."""
    return next((_split(row.keys) for row in rows if "." not in key and key in _split(row.keys)), (key,))


def _overlap(one: str, other: str) -> bool:
    return one == other or one.startswith(f"{other}.") or other.startswith(f"{one}.")


def _refuse_void(given: Mapping[str, Given], row: Void) -> None:
    """Raise ConfigError, with the reason of the rule, for options that would do nothing."""
    beside = [found for each in _split(row.beside) if (found := _found(given, each))]
    if any(_found(given, each) for each in _split(row.unless)) or (row.beside and not beside):
        return
    asked = _split(row.options)
    if row.options == "*":
        kept = {each.partition(" ")[0] for each in (*_split(row.but), *_split(row.beside))}
        asked = tuple(name for name in given if name not in kept)
    if void := [found for each in asked if (found := _found(given, each))]:
        needed = [each if each.startswith("--") else each.partition(" ")[2] or each for each in _split(row.unless)]
        other = f"with {' and '.join(beside)}" if beside else f"without {' or '.join(needed)}"
        raise ConfigError(f"{', '.join(void)}: not {other}, {row.reason}")


def _found(given: Mapping[str, Given], asked: str) -> str:
    """Return an option, or the text of an argument, that a rule names; empty if it is not given."""
    name, _, value = asked.partition(" ")
    one = given.get(name)
    texts = [str(text) for text in one.texts if text is not False] if one is not None else []
    if one is None or not any(fnmatchcase(text, value or "*") for text in texts):
        return ""
    return asked if one.is_option else shown(texts[0])


def _split(words: str) -> Sequence[str]:
    return tuple(filter(None, map(str.strip, words.split(","))))
