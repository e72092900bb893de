"""Steps of the laws for the one loop of all laws: compiled code that selects a step by the type of its parameters.

Numba compiles the loop of `lockstep` once for each pair of law and instrument, and stores the result on disk. The
selection happens at compile time, so it costs nothing at run time; without the compiler the same names look up the step
in plain Python. Steps passed as arguments would be compiled again by every process.
"""

from collections.abc import Callable
from typing import Any, cast

from telenano.extend.laws import Law
from telenano.numerics.compiler import chosen_step
from telenano.sections.controller_section import KNOWN_LAWS, ControllerConfig

Step = Callable[..., Any]


def _laws_by_parameters() -> dict[type, Law]:
    """Return the law for each class of parameters; raise TypeError if two laws share one."""
    table: dict[type, Law] = {}
    for name, law in KNOWN_LAWS.items():
        kind = type(ControllerConfig.model_validate({"law": name}).params())
        if kind in table:
            raise TypeError(f"the laws {table[kind].name} and {name} share the parameters {kind.__name__}")
        table[kind] = law
    return table


_LAW_OF = _laws_by_parameters()


def _chosen(name: str) -> Callable[[type], Step]:
    def choose(kind: type) -> Step:
        return cast(Step, getattr(_LAW_OF[kind], name))

    return choose


master_start = chosen_step(_chosen("master_start"))
master_send = chosen_step(_chosen("master_send"))
master_receive = chosen_step(_chosen("master_receive"))
slave_start = chosen_step(_chosen("slave_start"))
slave_receive = chosen_step(_chosen("slave_receive"))
slave_send = chosen_step(_chosen("slave_send"))
