"""The state of a model as plain values: what changes after it is built, which each model names in `state_fields`."""

from collections import deque
from typing import Any


def capture_model(model: Any) -> list[Any]:
    """Return the state of a model; a part that is a model itself, or a list of models, goes in with its own."""
    return [_captured(getattr(model, name)) for name in model.state_fields]


def restore_model(model: Any, state: list[Any]) -> None:
    """Put a model that was just built into a captured state; ValueError or TypeError when it does not fit."""
    for name, value in zip(model.state_fields, state, strict=True):
        part = getattr(model, name)
        if _is_model(part):
            restore_model(part, value)
        elif _is_models(part):
            for inner, own in zip(part, value, strict=True):
                restore_model(inner, own)
        else:
            # a deque or a counter comes back as what it was
            setattr(model, name, type(part)(value) if isinstance(part, deque | list | dict) else value)


def _captured(value: Any) -> Any:
    if _is_model(value):
        return capture_model(value)
    if _is_models(value):
        return [capture_model(inner) for inner in value]
    return list(value) if isinstance(value, deque) else value


def _is_model(value: Any) -> bool:
    return hasattr(value, "state_fields")


def _is_models(value: Any) -> bool:
    return isinstance(value, tuple) and bool(value) and all(map(_is_model, value))
