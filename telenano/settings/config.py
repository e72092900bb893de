"""The one configuration loader: a YAML file, then the environment, then flags; every error names file and key."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar, cast, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from telenano.files.regular_files import read_regular
from telenano.files.yaml_text import LARGEST_BYTES, YamlError, yaml_value
from telenano.wire.errors import ConfigError, RefusedError, known_names, probably_meant

M = TypeVar("M", bound=BaseModel)
T = TypeVar("T", bound=tuple[Any, ...])

ENVIRONMENT_PREFIX = "TELENANO__"
# If this variable is not empty, a scenario may name code: a function of a sample, a library of a device.
ALLOW_CODE_VARIABLE = "TELENANO_ALLOW_CODE"
# The deepest nesting that is accepted: real sections are far shallower, and recursive code can still walk this far.
_DEEPEST = 16
# At most this many faults of one document are reported, so that a thousand wrong keys cost no more than that.
_MOST_FAULTS = 20
# The unit of a key by the end of its name, the longer ends first.
_UNITS = {
    "_n_s_per_m": "N s/m", "_n_per_m": "N/m", "_n_per_v": "N/V", "_m_per_s": "m/s", "_m_per_v": "m/V",
    "_hz": "Hz", "_kg": "kg", "_pa": "Pa", "_k": "K", "_v": "V", "_s": "s", "_n": "N", "_m": "m",
}  # fmt: skip


class Settings(BaseModel):
    """The base of settings: frozen and strict, without unknown keys and without infinite numbers."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def from_file(cls, path: Path) -> Self:
        """Read the settings in a YAML file; ConfigError names file and key."""
        return validate(cls, read_yaml(path), str(path))


# The prefix of the attributes for packages' sections. No method of a model begins with it, so the key of a package
# collides with nothing but other keys.
_OF_PACKAGE = "package_"


def package_fields(sections: Mapping[str, tuple[Any, Any, str]], titles: Mapping[str, str] | None = None) -> Any:
    """Return fields of a model for the sections of packages.

    `section_of` reads such a section. The model needs `serialize_by_alias`, so that it is written with the keys with
    which it is read.

    Args:
        sections: For each key the type, the default and the description of its section.
        titles: For a key, a title for people.
    """
    return {
        f"{_OF_PACKAGE}{key}": (
            kind,
            Field(default, alias=key, description=description, title=(titles or {}).get(key)),
        )
        for key, (kind, default, description) in sections.items()
    }


def section_of(settings: BaseModel, key: str) -> Any:
    """Return the section under a key, one of the node's own or one of a package."""
    return getattr(settings, key if key in type(settings).model_fields else f"{_OF_PACKAGE}{key}")


def keys_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by the keys that a person writes."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def filled(kind: type[T], settings: BaseModel, /, **others: Any) -> T:
    """Return a NamedTuple of constants: `others`, and the settings with the names of its other fields."""
    fields: tuple[str, ...] = cast(Any, kind)._fields
    own = {name: getattr(settings, name) for name in fields if name in type(settings).model_fields}
    return kind(**{**own, **others})


def permit_code() -> None:
    """Allow this process and its children to run code that settings name; the user who started it has named it."""
    os.environ[ALLOW_CODE_VARIABLE] = "1"


def refused_code(setting: str, named: str) -> str:
    """Return why the code that a setting names is not run; empty where the user who started this process allows it."""
    if os.environ.get(ALLOW_CODE_VARIABLE):
        return ""
    return (
        f"{setting} {named}: it is code, and a scenario is data: if you trust its author, allow it with "
        f"`telenano up --allow-code`, or {ALLOW_CODE_VARIABLE}=1 in the environment"
    )


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file; ConfigError names the file, line and what is wrong."""
    try:
        return parse_yaml(read_regular(path, LARGEST_BYTES), str(path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error


def parse_yaml(content: bytes, origin: str) -> dict[str, Any]:
    """Return the mapping in the content of a YAML file; ConfigError names its origin, line and what is wrong."""
    try:
        data = yaml_value(content.decode())
    except UnicodeDecodeError as error:
        raise ConfigError(f"{origin}: is not UTF-8 text (byte {error.start})") from error
    except YamlError as error:
        raise ConfigError(f"{origin}: is not valid YAML: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{origin}: contains a {type(data).__name__}, must contain a mapping of keys")
    return data


def environment_overrides(environment: Mapping[str, str] = os.environ) -> dict[str, Any]:
    """Return TELENANO__SECTION__KEY=value as nested keys in lower case, each value read as YAML."""
    overrides: dict[str, Any] = {}
    for name, value in environment.items():
        if name.startswith(ENVIRONMENT_PREFIX):
            path = name.removeprefix(ENVIRONMENT_PREFIX).lower().split("__")
            _put(overrides, path, _scalar(value, f"environment variable {name}"), f"environment variable {name}")
    return overrides


def flag_overrides(flags: Sequence[str]) -> dict[str, Any]:
    """Return `section.key=value` flags as nested keys, each value read as YAML."""
    overrides: dict[str, Any] = {}
    for flag in flags:
        key, sign, value = flag.partition("=")
        if not sign or not key:
            raise ConfigError(f"--set {flag}: is not of the form section.key=value")
        _put(overrides, key.split("."), _scalar(value, f"--set {flag}"), f"--set {flag}")
    return overrides


def nested(flat: Mapping[str, Any], origin: str) -> dict[str, Any]:
    """Return dotted keys as nested ones; ConfigError when a key is both a value and a section."""
    tree: dict[str, Any] = {}
    for key, value in flat.items():
        _put(tree, key.split("."), value, origin)
    return tree


def flatten(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested keys as dotted ones, the inverse of `nested`; an empty mapping leaves no key."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{below}": leaf for below, leaf in flatten(value).items()}
        else:
            flat[key] = value
    return flat


def merge(*layers: Mapping[str, Any]) -> dict[str, Any]:
    """Merge mappings key by key; the last one wins.

    A mapping with another `kind` replaces the one before as a whole, because their keys are unrelated, such as those of
    an operator that follows a path and of one that trembles.
    """
    merged: dict[str, Any] = {}
    for layer in layers:
        for key, value in layer.items():
            below = merged.get(key)
            if isinstance(below, dict) and isinstance(value, dict) and not _of_another_kind(below, value):
                value = merge(below, value)
            merged[key] = value
    return merged


def _of_another_kind(below: Mapping[str, Any], value: Mapping[str, Any]) -> bool:
    return "kind" in below and "kind" in value and below["kind"] != value["kind"]


def validate(model: type[M], data: Mapping[str, Any], origin: str, section: str = "") -> M:
    """Validate a mapping against a model.

    Raises:
        ConfigError: Keys are wrong; the message names `origin`, every key at fault (below `section`, if given) and what
            would be right.
    """
    try:
        # The data passes through JSON, so that a YAML list is accepted where a strict model has a tuple. Dates, which
        # YAML makes of some texts, become texts again: the error of the model then names the key.
        return model.model_validate_json(json.dumps(data, allow_nan=True, default=str))
    except (TypeError, ValueError) as error:
        if isinstance(error, ValidationError):
            # pydantic refuses text that JSON cannot express without naming its key, and quotes the whole document.
            if error.errors()[0]["type"] == "json_invalid" and (undecodable := _undecodable(data)):
                raise ConfigError(f"{origin}: {undecodable}") from error
            raise ConfigError(*_described(error, origin, model, section)) from error
        raise ConfigError(f"{origin}: {error}") from error


def changed_disturbances(config: M, parameters: Mapping[str, Any], node: str) -> M:
    """Return disturbances with keys `disturbances.…` changed by a command; RefusedError says what is wrong."""
    section = "disturbances"
    try:
        document = merge({section: config.model_dump()}, nested(parameters, "session/control"))
        if others := sorted(set(document) - {section}):
            raise RefusedError(f"{node}.{', '.join(others)}: unknown key; keys here begin with {section}")
        return validate(type(config), document[section], "session/control", f"{node}.{section}")
    except ConfigError as error:
        raise RefusedError(str(error)) from error


def _undecodable(value: Any, key: str = "") -> str:
    """Return a sentence about the first text that is no Unicode, such as a path that the locale cannot express."""
    if isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError:
            shown = os.fsencode(value).decode("ascii", "backslashreplace")
            remedy = "run with PYTHONUTF8=1, or under a locale such as C.UTF-8"
            return f"{key}: {shown} cannot be read as text under this locale: {remedy}"
        return ""
    parts = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else ()
    faults = (_undecodable(part, f"{key}.{name}" if key else str(name)) for name, part in parts)
    return next(filter(None, faults), "")


def layered(path: Path, flags: Sequence[str] = ()) -> tuple[dict[str, Any], str]:
    """Read a file and merge environment and flags over it.

    Returns:
        The merged mapping, and its origin in words for errors.

    Raises:
        ConfigError: A source cannot be read; the message names the file, the variable or the flag.
    """
    environment, overrides = environment_overrides(), flag_overrides(flags)
    layers = [str(path)] + ["environment"] * bool(environment) + ["--set"] * bool(overrides)
    return merge(read_yaml(path), environment, overrides), " + ".join(layers)


def _scalar(text: str, origin: str) -> Any:
    try:
        return yaml_value(text)
    except YamlError as error:
        raise ConfigError(f"{origin}: the value is not valid YAML: {error}") from error


def _put(tree: dict[str, Any], path: Sequence[str], value: Any, origin: str) -> None:
    if len(path) > _DEEPEST:
        raise ConfigError(f"{origin}: {'.'.join(path)[:80]}... has {len(path)} parts, at most {_DEEPEST} are allowed")
    for part in path[:-1]:
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            raise ConfigError(f"{origin}: {part} already has a value and cannot have keys below it")
    tree[path[-1]] = value


def _described(error: ValidationError, origin: str, model: type[BaseModel], section: str) -> list[str]:
    lines = []
    faults = error.errors(include_url=False, include_context=False)
    for fault in faults[:_MOST_FAULTS]:
        key = ".".join(str(part) for part in (section, *fault["loc"]) if part != "")
        text = fault["msg"].removeprefix("Value error, ")
        if fault["type"] == "extra_forbidden":
            text = f"unknown key{_known_keys(model, fault['loc'])}"
        elif fault["type"] == "missing":
            text = "is missing"
        elif not isinstance(fault["input"], dict | list):
            text = f"{text}{_unit(fault)}{_allowed(fault, model)}, got {fault['input']!r:.200}{_near(fault)}"
        lines.append(f"{origin}: {key + ': ' if key else ''}{text}")
    if len(faults) > _MOST_FAULTS:
        lines.append(f"{origin}: and {len(faults) - _MOST_FAULTS} more")
    return lines


def _unit(fault: Mapping[str, Any]) -> str:
    """Return the unit of a key that takes a bare number as text, if a text such as `40ms` was given; else ''."""
    if fault["type"] != "float_type" or not isinstance(fault["input"], str):
        return ""
    name = str(fault["loc"][-1])
    return next((f" in {unit}" for end, unit in _UNITS.items() if name.endswith(end)), "")


def _near(fault: Mapping[str, Any]) -> str:
    """Return a hint with the choice that was probably meant."""
    if fault["type"] != "literal_error":
        return ""
    return probably_meant(str(fault["input"]), re.findall(r"'([^']*)'", fault["msg"]))


def _allowed(fault: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Return the two bounds of a value beyond one of them as text; empty if the path does not lead to its field."""
    if fault["type"] not in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return ""
    *path, name = fault["loc"]
    owner = _model_at(model, path)
    field = keys_of(owner).get(str(name)) if owner is not None else None
    bounds = bounds_of(field) if field is not None else {}
    low = next((f"from {word}{bounds[key]:g}" for key, word in (("ge", ""), ("gt", "above ")) if key in bounds), "")
    high = next((f"to {word}{bounds[key]:g}" for key, word in (("le", ""), ("lt", "below ")) if key in bounds), "")
    return f" (allowed is {low} {high})" if low and high else ""


def bounds_of(part: Any) -> dict[str, float]:
    """Return ge, gt, le and lt of a field, or of a type within its annotation."""
    bounds: dict[str, float] = {}
    for rule in getattr(part, "metadata", getattr(part, "__metadata__", ())):
        # A rule is a bound itself, or the field of an annotation.
        bounds |= bounds_of(rule) if isinstance(rule, FieldInfo) else {}
        bounds |= {key: getattr(rule, key) for key in ("ge", "gt", "le", "lt") if hasattr(rule, key)}
    for inner in get_args(part.annotation if isinstance(part, FieldInfo) else part):
        bounds |= bounds_of(inner)
    return bounds


def _known_keys(model: type[BaseModel], path: tuple[int | str, ...]) -> str:
    """Return a hint with the keys that would be right."""
    owner = _model_at(model, path[:-1])
    return f", {known_names(str(path[-1]), keys_of(owner))}" if owner is not None else ""


def _model_at(model: type[BaseModel], path: Sequence[int | str]) -> type[BaseModel] | None:
    """Return the model that a path leads to through models and mappings of them, None where it leads elsewhere."""
    kind: Any = model
    for part in path:
        if get_origin(kind) is dict:
            kind = get_args(kind)[1]
        elif isinstance(kind, type) and issubclass(kind, BaseModel) and str(part) in (keys := keys_of(kind)):
            field = keys[str(part)]
            # The section of a package's entry has a rule that knows its model.
            kind = next((rule.model for rule in field.metadata if hasattr(rule, "model")), field.annotation)
        else:
            return None
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None
