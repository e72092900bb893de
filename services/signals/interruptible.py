"""Compiled functions as Python calls them: a signal that arrives in one is raised when it has returned."""

from typing import Any

from numba.core.registry import CPUDispatcher

from services.signals import interrupts

_call = CPUDispatcher.__call__


class InterruptibleDispatcher(CPUDispatcher):
    """A compiled function that SIGINT and SIGTERM cannot end in the middle; numba's in all else."""

    def __call__(self, *args: Any, **keywords: Any) -> Any:
        interrupts.watch()
        try:
            return _within(self, args, keywords)
        finally:
            interrupts.raise_held()


def _within(dispatcher: CPUDispatcher, args: Any, keywords: Any) -> Any:
    return _call(dispatcher, *args, **keywords)


_numba: Any = CPUDispatcher
interrupts.register(_within, _numba._compile_for_args)
