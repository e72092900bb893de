"""The `telenano` command, and what programs may use: `open` a recording, connect to a rig that is `live`."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from telenano.api import LiveRig as LiveRig
    from telenano.api import RecordedSession as RecordedSession
    from telenano.api import Table as Table
    from telenano.api import live as live
    from telenano.api import open as open

__all__ = ["LiveRig", "RecordedSession", "Table", "live", "open"]


def __getattr__(name: str) -> Any:
    # the command begins faster without what it may not need
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from telenano import api

    return getattr(api, name)
