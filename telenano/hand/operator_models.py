"""The models of the simulated hand: those of `operator`, and those of installed packages (`telenano.operators`)."""

from collections.abc import Callable
from typing import Any, Literal, Self, cast, get_args

from pydantic import BaseModel, model_validator

from telenano.extend.operators import OperatorModel
from telenano.hand import operator, reacting
from telenano.hand.operator import OperatorParams, OperatorState
from telenano.hand.reacting import ReactingParams
from telenano.numerics.compiler import chosen_step
from telenano.settings.plugins import load

Step = Callable[..., Any]


def _checked(name: str, value: Any) -> OperatorModel:
    if not isinstance(value, OperatorModel):
        raise TypeError(f"is a {type(value).__name__}, must be an OperatorModel")
    kind = value.config.model_fields.get("kind")
    if value.name != name or kind is None or get_args(kind.annotation) != (name,):
        raise ValueError(f"name and config.kind must be {name!r}")
    for owner, fields in (("config", value.config.model_fields), ("params", getattr(value.params, "_fields", ()))):
        if "max_force_n" not in fields:
            raise ValueError(f"{owner} has no max_force_n")
    return value


def unusable_config(name: str, problem: str) -> type[BaseModel]:
    """Return settings of a kind that nothing satisfies: choosing it is refused with the problem."""

    class Unusable(BaseModel):
        kind: Literal[name]  # type: ignore[valid-type]

        @model_validator(mode="after")
        def _say_why(self) -> Self:
            raise ValueError(problem)

    return Unusable


OWN_OPERATORS = ("force_profile", "impedance", "interactive", "reacting")
OPERATOR_MODELS = load("operators", _checked, OWN_OPERATORS)
_MODEL_OF = {model.params: model for model in OPERATOR_MODELS.found.values()}


def _step_of(kind: type) -> Step:
    own: dict[type, Step] = {OperatorParams: operator.step, ReactingParams: reacting.step}
    return own[kind] if kind in own else _MODEL_OF[kind].step


operator_step = chosen_step(_step_of)


def operator_at_rest(params: Any, position_m: float) -> Any:
    """Return the hand at rest at position_m [m]."""
    if type(params) is OperatorParams:
        return OperatorState(position_m, 0.0)
    if type(params) is ReactingParams:
        return reacting.at_rest(params, position_m)
    return cast(Any, _MODEL_OF[type(params)].start(params, position_m))
