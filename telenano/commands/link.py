"""`telenano link`: what the link of a running rig does, in words and figures."""

from typing import Any

from proto.errors import RigError
from services.delay_node.profiles import PROFILES
from services.runtime.observer import Observer, message_fields, messages_of

_PATIENCE_S = 3.0
_COUNTS = ("messages_in", "messages_out", "duplicated", "reordered", "corrupted", "queue_depth")
_DELAYS = ("delay_mean_s", "delay_min_s", "delay_max_s")


def current_status(observer: Observer) -> dict[str, Any]:
    """Give the fields of the next link/status; RigError when no link is heard."""
    for received in messages_of(observer, "link/status", _PATIENCE_S, 1):
        return message_fields(received.message)
    raise RigError("no link is heard, is `telenano up` running with this site file?")


def status_rows(status: dict[str, Any]) -> list[dict[str, Any]]:
    """Give a status as rows of a table: what, forward, backward."""
    ways = (status["forward"], status["backward"])
    rows: list[dict[str, Any]] = [_row("profile", *(way["profile"] for way in ways))]
    keys = sorted({key for way in ways for key in way["settings"]})
    rows += [_row(key, *(way["settings"].get(key, "") for way in ways)) for key in keys]
    rows += [_row(key, *(way[key] for way in ways)) for key in _COUNTS]
    rows.append(_row("dropped", *(_causes(way["dropped"]) for way in ways)))
    rows += [_row(key, *(way[key] if way["delay_valid"] else "" for way in ways)) for key in _DELAYS]
    clock = status["clock"]
    if clock["valid"]:
        rows.append(_row("clock offset of the slave [s]", clock["offset_s"], f"± {clock['uncertainty_s']:.6f}"))
    return rows


def profile_rows() -> list[dict[str, Any]]:
    """Give the named profiles as rows of a table."""
    return [{"profile": name, "what": profile.about} for name, profile in PROFILES.items()]


def _row(what: str, forward: Any, backward: Any) -> dict[str, Any]:
    return {"what": what, "forward": forward, "backward": backward}


def _causes(dropped: dict[str, int]) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in dropped.items()) or "0"
