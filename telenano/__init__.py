"""The `telenano` command, and the functions for programs of your own.

`open` reads a recording and `open_all` many of them, `simulate` runs a session and `simulate_all` many, `live` connects
to a running rig, `curves` fits force curves, and `check_law` tests a law.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from telenano.analysis.session import Session as Session
    from telenano.api import LiveRig as LiveRig
    from telenano.api import RecordedSession as RecordedSession
    from telenano.api import Table as Table
    from telenano.api import check_law as check_law
    from telenano.api import curves as curves
    from telenano.api import live as live
    from telenano.api import open as open
    from telenano.api import open_all as open_all
    from telenano.lockstep.simulation import SimulatedSession as SimulatedSession
    from telenano.virtual.simulate import simulate as simulate
    from telenano.virtual.simulate_all import simulate_all as simulate_all

    __version__: str

_ELSEWHERE = {
    "Session": ("telenano.analysis.session", "Session"),
    "SimulatedSession": ("telenano.lockstep.simulation", "SimulatedSession"),
    "simulate": ("telenano.virtual.simulate", "simulate"),
    "simulate_all": ("telenano.virtual.simulate_all", "simulate_all"),
}

__all__ = [
    "LiveRig",
    "RecordedSession",
    "Session",
    "SimulatedSession",
    "Table",
    "check_law",
    "curves",
    "live",
    "open",
    "open_all",
    "simulate",
    "simulate_all",
]


def __dir__() -> list[str]:
    """Return the names for programs, without those that this module needs for itself."""
    return [*__all__, "__version__"]


if not TYPE_CHECKING:
    # A type checker must not see this function, so that it reports names that are not imported above.
    def __getattr__(name: str) -> Any:
        # Names are imported at their first use, so that the command starts faster.
        if name == "__version__":
            from importlib.metadata import version

            return version("telenano")
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}: it has {', '.join(__all__)}")
        try:
            module, attribute = _ELSEWHERE.get(name, ("telenano.api", name))
            return getattr(import_module(module), attribute)
        except ModuleNotFoundError as error:
            package = (error.name or "").partition(".")[0]
            if package in ("", "services", "telenano"):
                raise
            from telenano.wire.extras import missing

            raise ModuleNotFoundError(f"telenano.{name}: {missing(package)}", name=error.name) from error
