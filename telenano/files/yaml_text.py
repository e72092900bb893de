"""Reading of YAML within limits, so that a few lines of it can neither fill the memory nor take minutes.

This module imports only PyYAML, because the emergency stop has no time to load anything else.
"""

import re
from typing import Any

import yaml

# A scenario with every key has 8 kB; the parser takes some seconds for this size.
LARGEST_BYTES = 1 << 18
# Most values of a text with all aliases expanded, because validation and printing walk through them.
_MOST_VALUES = 100_000
# Most characters of a number: no quantity needs more, and Python's parsing takes the square of the count.
_LONGEST_NUMBER = 100
# A lone surrogate, which an escape such as "\\ud800" makes.
_HALF = re.compile("[\ud800-\udfff]")
_MERGE_TAG = "tag:yaml.org,2002:merge"
_NUMBER_TAGS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


class YamlError(ValueError):
    """A text is not YAML, or beyond the limits; the message names the fault and, if known, its line."""


# Numbers that YAML 1.1 reads otherwise than people mean them. It reads digits with an 8 or 9 after a leading 0 as text,
# such as the identity of a device, which its writers leave unquoted.
_OTHER_BASE = re.compile(
    r"[-+]?(?:0[0-7_]+|0[0-9_]+\.[0-9_]*(?:[eE][-+]?[0-9]+)?|0[0-9_]+[eE][-+]?[0-9]+|0[xXoObB][0-9a-fA-F_]+|[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?)"
)
_REPLACED = ("tag:yaml.org,2002:bool", *_NUMBER_TAGS)


class _Loader(yaml.SafeLoader):
    """A safe loader of plain values in which 1e-9 is a number, on and off are texts, and numbers have base 10.

    In YAML 1.1, 1e-9 (without a point) is a text, on, off, yes and no are booleans, 1:30 is 90 and 012 is 10.
    """


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in _REPLACED]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"(?i:true|false)$"), list("tTfF"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"[-+]?(?:0|[1-9][0-9_]*)$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?[0-9]+[eE][-+]?[0-9]+|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+.0123456789"),
)


def yaml_value(text: str) -> Any:
    """Return the value of a YAML text: plain Python data, None if it is empty.

    Raises:
        YamlError: The text is not YAML, beyond a limit, or has a duplicate key or a number of another base than 10.
    """
    if len(text) > LARGEST_BYTES:
        raise YamlError(f"it has {len(text)} characters, and at most {LARGEST_BYTES} are read")
    try:
        loader = _Loader(text)
    except yaml.YAMLError as error:
        raise YamlError(_sentence(error)) from error
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _check_characters(node)
        _check_size(node)
        _check_keys(node, loader, (), set())
        return loader.construct_document(node)
    except RecursionError as error:
        raise YamlError("it is nested too deeply") from error
    except yaml.YAMLError as error:
        raise YamlError(_sentence(error)) from error
    except YamlError:
        raise
    # A value does not fit its tag or its form, such as the 45th of a month or `!!int x`.
    except Exception as error:
        raise YamlError(f"a value in it cannot be read: {_sentence(error)}") from error
    finally:
        loader.dispose()


def _sentence(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _line(node: yaml.Node) -> str:
    return f"line {node.start_mark.line + 1}"


def _check_size(root: yaml.Node) -> None:
    """Raise YamlError if expanded aliases have too many values or a cycle, or a number is too long or not base 10."""
    counts: dict[int, int] = {}

    def count(node: yaml.Node) -> int:
        counted = counts.get(id(node))
        if counted == 0:
            raise YamlError(f"the value in {_line(node)} is part of itself")
        if counted is not None:
            return counted
        counts[id(node)] = 0
        total = 1
        if isinstance(node, yaml.ScalarNode):
            if node.style is None and _OTHER_BASE.fullmatch(node.value):
                raise YamlError(_refusal_of_base(node))
            if node.tag in _NUMBER_TAGS and len(node.value) > _LONGEST_NUMBER:
                raise YamlError(
                    f"the number in {_line(node)} has {len(node.value)} characters, at most {_LONGEST_NUMBER} are read"
                )
        elif isinstance(node, yaml.SequenceNode):
            total += sum(map(count, node.value))
        else:
            total += sum(count(key) + count(value) for key, value in node.value)
        if total > _MOST_VALUES:
            raise YamlError(f"it has more than {_MOST_VALUES} values, each alias (*NAME) written out; no more are read")
        counts[id(node)] = total
        return total

    count(root)


def _refusal_of_base(node: yaml.ScalarNode) -> str:
    """Return an error text for a number that has, or seems to have, another base than 10, with the decimal form."""
    word, plain = node.value, ""
    if ":" in word:
        total = 0.0
        for part in word.lstrip("+-").split(":"):
            total = 60.0 * total + float(part.replace("_", ""))
        plain = f"{'-' if word.startswith('-') else ''}{total:g} for that number of seconds or minutes"
    elif word.lstrip("+-")[1:2].isalpha():
        plain = f"{int(word.replace('_', ''), 0)}" if len(word) <= _LONGEST_NUMBER else "its value"
    else:
        digits = word.lstrip("+-").replace("_", "").lstrip("0")
        digits = digits if digits[:1].isdigit() else f"0{digits}"
        plain = f"{'-' if word.startswith('-') else ''}{digits[:_LONGEST_NUMBER]}"
    text = f"{word[:_LONGEST_NUMBER]} in {_line(node)} is not a number of base 10"
    return f"{text}: write {plain}, or '{word[:40]}' for a text"


def _check_characters(root: yaml.Node) -> None:
    """Raise YamlError if an escape makes a lone surrogate, which cannot be written to a file or a terminal."""
    seen: set[int] = set()
    waiting = [root]
    while waiting:
        node = waiting.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.ScalarNode):
            if half := _HALF.search(node.value):
                raise YamlError(f"\\u{ord(half[0]):04x} in {_line(node)} is half of a character, and no text")
        else:
            parts = (part for pair in node.value for part in (pair if isinstance(pair, tuple) else (pair,)))
            waiting.extend(parts)


def _check_keys(node: yaml.Node, loader: _Loader, path: tuple[str, ...], seen: set[int]) -> None:
    """Raise YamlError for a duplicate key of a mapping; the message has its dotted path and the line."""
    # An alias repeats a node, and may be part of itself.
    if id(node) in seen or isinstance(node, yaml.ScalarNode):
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for place, item in enumerate(node.value):
            _check_keys(item, loader, (*path, str(place)), seen)
        return
    names: set[str] = set()
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            # The construction reports a key that no plain mapping can have.
            continue
        # Compare constructed keys, because `true` and `True` are one key; only `<<` cannot be constructed by itself.
        name = key.value if key.tag == _MERGE_TAG else str(loader.construct_object(key))
        if name in names:
            line = key.start_mark.line + 1
            raise YamlError(f"{'.'.join((*path, name))} is given twice, the second time in line {line}")
        names.add(name)
        _check_keys(value, loader, (*path, name), seen)
