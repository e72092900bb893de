"""The models of the simulated hand: those of `operator` and `reacting`, and those that packages register."""

from collections.abc import Callable
from typing import Any, cast

from telenano.extend.operators import OperatorModel
from telenano.hand import operator, reacting
from telenano.hand.operator import OperatorParams, OperatorState
from telenano.hand.reacting import ReactingParams
from telenano.numerics.compiler import chosen_step

Step = Callable[..., Any]


_MODEL_OF: dict[type, OperatorModel] = {}


def register_operator(model: OperatorModel) -> None:
    """Register a model of the operator under the class of its parameters."""
    _MODEL_OF[model.params] = model


def _step_of(kind: type) -> Step:
    own: dict[type, Step] = {OperatorParams: operator.step, ReactingParams: reacting.step}
    return own[kind] if kind in own else _MODEL_OF[kind].step


operator_step = chosen_step(_step_of)


def operator_at_rest(params: Any, position_m: float) -> Any:
    """Return the state of the hand at rest at position_m [m]."""
    if type(params) is OperatorParams:
        return OperatorState(position_m, 0.0)
    if type(params) is ReactingParams:
        return reacting.at_rest(params, position_m)
    return cast(Any, _MODEL_OF[type(params)].start(params, position_m))
