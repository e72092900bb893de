"""One loop for every law and every instrument: compiled code that chooses the step by the type of its parameters.

Numba compiles the loop of `lockstep` once for each pair of law and instrument and keeps the result on disk. The choice
is made while compiling, so it costs nothing at run time; without the compiler the same names look the step up in plain
Python. Steps handed over as arguments would be compiled anew by every process.
"""

from collections.abc import Callable
from typing import Any, cast

from numba.extending import overload

from services.afm_node import spring
from services.afm_node import step as afm
from services.afm_node.spring import SpringParams
from services.afm_node.step import AfmParams
from services.controller.config import LAWS, ControllerConfig
from services.controller.law import Law
from studies import body
from studies.body import BodyParams

Step = Callable[..., Any]


def _laws_by_parameters() -> dict[type, Law]:
    """Return the law of each class of parameters; two laws must not share one."""
    table: dict[type, Law] = {}
    for name, law in LAWS.items():
        kind = type(ControllerConfig.model_validate({"law": name}).params())
        if kind in table:
            raise TypeError(f"the laws {table[kind].name} and {name} share the parameters {kind.__name__}")
        table[kind] = law
    return table


_LAW_OF = _laws_by_parameters()
_INSTRUMENT_OF: dict[type, Step] = {AfmParams: afm.step, SpringParams: spring.step, BodyParams: body.step}


def _chosen(name: str) -> Callable[[type], Step]:
    def choose(kind: type) -> Step:
        return cast(Step, getattr(_LAW_OF[kind], name))

    return choose


def _with_sample(choose: Callable[[type], Step]) -> Step:
    """Return a function of (params, sample) that calls the step chosen by the type of params."""

    def plain(params: Any, sample: Any) -> Any:
        return choose(type(params))(params, sample)

    def typed(params: Any, sample: Any) -> Step:
        step = choose(params.instance_class)
        return lambda params, sample: step(params, sample)

    overload(plain, strict=False)(typed)
    return plain


def _with_state(choose: Callable[[type], Step]) -> Step:
    """Return a function of (params, state, inputs, dt) that calls the step chosen by the type of params."""

    def plain(params: Any, state: Any, inputs: Any, dt: float) -> Any:
        return choose(type(params))(params, state, inputs, dt)

    def typed(params: Any, state: Any, inputs: Any, dt: Any) -> Step:
        step = choose(params.instance_class)
        return lambda params, state, inputs, dt: step(params, state, inputs, dt)

    overload(plain, strict=False)(typed)
    return plain


def _with_two_inputs(choose: Callable[[type], Step]) -> Step:
    """Return a function of (params, state, first, second, dt) that calls the step chosen by the type of params."""

    def plain(params: Any, state: Any, first: Any, second: Any, dt: float) -> Any:
        return choose(type(params))(params, state, first, second, dt)

    def typed(params: Any, state: Any, first: Any, second: Any, dt: Any) -> Step:
        step = choose(params.instance_class)
        return lambda params, state, first, second, dt: step(params, state, first, second, dt)

    overload(plain, strict=False)(typed)
    return plain


master_start = _with_sample(_chosen("master_start"))
master_send = _with_state(_chosen("master_send"))
master_receive = _with_two_inputs(_chosen("master_receive"))
slave_start = _with_sample(_chosen("slave_start"))
slave_receive = _with_two_inputs(_chosen("slave_receive"))
slave_send = _with_state(_chosen("slave_send"))
instrument_step = _with_state(lambda kind: _INSTRUMENT_OF[kind])
