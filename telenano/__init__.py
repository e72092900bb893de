"""The `telenano` command, and what programs use: `open` a recording, `simulate` a session, connect to a `live` rig."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.simulation import SimulatedSession as SimulatedSession
    from telenano.api import LiveRig as LiveRig
    from telenano.api import RecordedSession as RecordedSession
    from telenano.api import Table as Table
    from telenano.api import live as live
    from telenano.api import open as open
    from telenano.api import simulate as simulate

__all__ = ["LiveRig", "RecordedSession", "SimulatedSession", "Table", "live", "open", "simulate"]


def __getattr__(name: str) -> Any:
    # the command begins faster without what it may not need
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "SimulatedSession":
        from studies.simulation import SimulatedSession

        return SimulatedSession
    from telenano import api

    return getattr(api, name)
