"""The kinds of simulated hands: those of this project, and those of installed packages (`telenano.operators`)."""

from typing import Any, Literal, Self, get_args

from pydantic import BaseModel, model_validator

from telenano.extend.operators import OperatorModel
from telenano.hand.operator_models import register_operator
from telenano.settings.plugins import load


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
    """Return a model for a kind of hand that cannot be used: its validation always fails, and says why."""

    class Unusable(BaseModel):
        kind: Literal[name]  # type: ignore[valid-type]

        @model_validator(mode="after")
        def _say_why(self) -> Self:
            raise ValueError(problem)

    return Unusable


OWN_OPERATORS = ("force_profile", "impedance", "interactive", "reacting")
OPERATOR_MODELS = load("operators", _checked, OWN_OPERATORS)
for _model in OPERATOR_MODELS.found.values():
    register_operator(_model)
