"""The curves of the page: columns of numbers that are made from the messages of the loop.

Positions and forces are along the paper's axis, towards the sample, as in Fig. 12; lateral forces are in the
instrument's frame. A value missing in a message is NaN, which the page draws as a gap.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

Fields = Mapping[str, Any]
_NONE = math.nan
# Latest valid time of any clock [ns]: differences of times up to this, corrected or not, fit into 64 bits.
LATEST_NS = 2**62


class Column(NamedTuple):
    """A column: name, unit, meaning, and the function that returns its value in a message."""

    name: str
    unit: str
    about: str
    value: Callable[[Fields], float]


class Stream(NamedTuple):
    """The columns of one topic from one site."""

    name: str
    topic: str
    site: str
    columns: tuple[Column, ...]


def _z(key: str, sign: float = -1.0) -> Callable[[Fields], float]:
    return lambda fields: 0.0 + sign * float(fields[key][2])


def _axis(key: str, axis: int) -> Callable[[Fields], float]:
    return lambda fields: float(fields[key][axis])


def _number(key: str) -> Callable[[Fields], float]:
    return lambda fields: float(fields[key])


def _if(flag: str, key: str) -> Callable[[Fields], float]:
    return lambda fields: float(fields[key]) if fields[flag] else _NONE


def _where_known(key: str) -> Callable[[Fields], float]:
    return lambda fields: _NONE if fields.get(key) is None else float(fields[key])


def _follows(fields: Fields) -> float:
    """Return 1 while the tip follows the hand or a program, and 0 while it is being placed, withdrawn, or away."""
    return float(fields["mode"] in ("follow", "hold") and fields.get("placed") is not False)


def _loop_age_s(fields: Fields) -> float:
    """Return the age of the hand's sample that the newest command answers, at the arrival of the command [s]."""
    sampled_ns = fields["answered_t_ns"]
    return (fields["answered_at_ns"] - sampled_ns) * 1e-9 if sampled_ns > 0 else _NONE


_LAW = (
    Column("port_energy", "J", "energy that entered at this port", _number("port_energy_j")),
    Column("net_energy", "J", "energy that entered at both ports less what left", _if("net_valid", "net_energy_j")),
    Column("power", "W", "power that enters at this port", _number("port_power_w")),
    Column(
        "round_trip",
        "s",
        "end-to-end latency: age of the hand's sample behind the newest answer",
        _if("round_trip_valid", "round_trip_s"),
    ),
)
STREAMS = (
    Stream(
        "hand",
        "haptic/state",
        "master",
        (
            Column("position", "m", "position of the hand", _z("position_m")),
            Column("reference", "m", "position reference of the device", _z("reference_m")),
            Column("force", "N", "force of the operator on the device", _z("operator_force_n")),
            Column("motor_force", "N", "force of the motor at the arm", _z("motor_force_n")),
            Column("loop_age", "s", "hand's sample to the command that answers it", _loop_age_s),
            Column("x", "m", "position of the hand across the sample, x", _axis("position_m", 0)),
            Column("y", "m", "position of the hand across the sample, y", _axis("position_m", 1)),
            Column(
                "operator_energy", "J", "what the hand has put into a device's coupling", _where_known("hand_energy_j")
            ),
            Column(
                "coupling_energy",
                "J",
                "what that spring and damper have taken in, less what they gave",
                _where_known("coupling_energy_j"),
            ),
        ),
    ),
    Stream(
        "command",
        "haptic/command",
        "master",
        (
            Column("tip_force", "N", "force on the tip at the hand's scale", _z("force_n", 1.0)),
            Column("force_x", "N", "force that the hand is shown across the sample, x", _axis("force_n", 0)),
            Column("force_y", "N", "force that the hand is shown across the sample, y", _axis("force_n", 1)),
        ),
    ),
    Stream(
        "tip",
        "afm/state",
        "slave",
        (
            Column("base", "m", "position of the base", _z("base_position_m")),
            Column("deflection", "m", "deflection of the cantilever", _number("deflection_m")),
            Column("force", "N", "force on the tip along its axis", _axis("tip_force_n", 2)),
            Column("force_x", "N", "lateral force on the tip, x", _axis("tip_force_n", 0)),
            Column("force_y", "N", "lateral force on the tip, y", _axis("tip_force_n", 1)),
            Column("x", "m", "position of the base, x", _axis("base_position_m", 0)),
            Column("y", "m", "position of the base, y", _axis("base_position_m", 1)),
            Column("separation", "m", "distance of tip and sample", _if("separation_valid", "separation_m")),
            Column("follows", "1", "1 while the tip is where it is wanted, 0 while placed or withdrawn", _follows),
        ),
    ),
    Stream("law_master", "law/status", "master", _LAW),
    Stream("law_slave", "law/status", "slave", _LAW),
    Stream(
        "link",
        "link/status",
        "master",
        (
            Column("forward_delay", "s", "mean delay, master to slave", lambda f: _delay_s(f["forward"])),
            Column("backward_delay", "s", "mean delay, slave to master", lambda f: _delay_s(f["backward"])),
            Column("forward_dropped", "1", "messages dropped since the start", lambda f: _dropped(f["forward"])),
            Column("backward_dropped", "1", "messages dropped since the start", lambda f: _dropped(f["backward"])),
            Column(
                "forward_loss", "1", "share dropped of the messages since the previous report", _number("forward_loss")
            ),
            Column(
                "backward_loss",
                "1",
                "share dropped of the messages since the previous report",
                _number("backward_loss"),
            ),
        ),
    ),
)
BY_SOURCE = {(stream.topic, stream.site): stream for stream in STREAMS}


def _delay_s(way: Fields) -> float:
    return float(way["delay_mean_s"]) if way["delay_valid"] else _NONE


def _dropped(way: Fields) -> float:
    return float(sum(way["dropped"].values()))


class LinkLoss:
    """Stores the counts of link/status, to add the share of losses since the previous message."""

    def __init__(self) -> None:
        self._before: dict[str, tuple[float, float]] = {}

    def added(self, fields: Fields) -> Fields:
        """Return the fields with `forward_loss` and `backward_loss`; NaN if no message came, or the counts restarted.

        A message counts as dropped at the time of its delivery, which is after its arrival, so the share is limited to
        1. Raises KeyError, TypeError or AttributeError for fields that are no link/status.
        """
        shares = {}
        for name in ("forward", "backward"):
            way = fields[name]
            counts = float(way["messages_in"]), _dropped(way)
            before = self._before.get(name, counts)
            self._before[name] = counts
            came, dropped = counts[0] - before[0], counts[1] - before[1]
            shares[f"{name}_loss"] = min(1.0, dropped / came) if came > 0.0 and dropped >= 0.0 else _NONE
        return {**fields, **shares}


class Batch:
    """Samples of a stream that are not sent to pages yet: times [ns], and a row of numbers for each."""

    def __init__(self, stream: Stream, most: int) -> None:
        """Begin empty; of more than `most` samples, as after a stall of this process, the oldest are dropped."""
        self.stream = stream
        self._most = most
        self._times_ns: list[int] = []
        self._rows: list[list[float]] = []

    def add(self, t_ns: int, fields: Fields) -> None:
        """Add a sample.

        Raises KeyError, TypeError, IndexError, ValueError or OverflowError for fields that are no such message.
        """
        row = [column.value(fields) for column in self.stream.columns]
        if not -LATEST_NS < t_ns < LATEST_NS:
            raise ValueError(f"t_ns {t_ns}: is not a time")
        self._times_ns.append(int(t_ns))
        self._rows.append(row)
        if len(self._rows) >= 2 * self._most:
            self._shorten()

    def take(self, origin_ns: int) -> dict[str, Any] | None:
        """Return and remove the samples; None if there are none.

        `n` is their number; `t0` is the time of the first one since the origin [s]; `data` holds float32 columns one
        after the other, of which the first is the time since `t0` [s].
        """
        self._shorten()
        if not self._rows:
            return None
        t0_ns = self._times_ns[0]
        times = (np.array(self._times_ns, dtype=np.int64) - t0_ns) * 1e-9
        with np.errstate(over="ignore"):
            columns = np.vstack([times[np.newaxis, :], np.array(self._rows).T]).astype("<f4")
        # A value that float32 cannot hold is none of the quantities shown.
        columns[np.isinf(columns)] = _NONE
        taken = {
            "n": len(self._rows),
            "t0": (t0_ns - origin_ns) * 1e-9,
            "data": columns.tobytes(),
        }
        self._times_ns, self._rows = [], []
        return taken

    def _shorten(self) -> None:
        over = len(self._rows) - self._most
        if over > 0:
            del self._rows[:over], self._times_ns[:over]


def described() -> list[dict[str, Any]]:
    """Return the streams for the page: names, units, meanings, in the order of the columns."""
    return [
        {
            "name": stream.name,
            "topic": stream.topic,
            "columns": [{"name": c.name, "unit": c.unit, "about": c.about} for c in stream.columns],
        }
        for stream in STREAMS
    ]
