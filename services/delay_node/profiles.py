"""Named networks: typical figures of published measurements, as partial settings.

Each is a plain mapping over the defaults; docs/link.md gives the source and the reasoning of every figure. Forward is
the operator's uplink: the operator sits at the end of an access line, the instrument near the core of the network.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

MEGABIT_BYTES_PER_S = 125_000.0


class Profile(NamedTuple):
    """A named network."""

    about: str
    settings: Mapping[str, Any]


def _line(
    delay_s: float, jitter_s: float, rate_mbit_per_s: float, buffer_s: float, **others: Mapping[str, float]
) -> dict[str, Any]:
    """Return an ordered line whose tail-drop buffer holds `buffer_s` of traffic."""
    rate_bytes_per_s = rate_mbit_per_s * MEGABIT_BYTES_PER_S
    return {
        "delay_s": delay_s,
        "jitter": {"scale_s": jitter_s, "distribution": "pareto", "correlation": 0.99},
        "order": "link",
        "rate": {"rate_bytes_per_s": rate_bytes_per_s, "overhead_bytes": 54},
        "queue": {"limit_messages": None, "limit_bytes": int(rate_bytes_per_s * buffer_s), "drop": "tail"},
        **others,
    }


def _bursts(loss_probability: float, mean_burst_messages: float) -> dict[str, float]:
    """Return the Gilbert-Elliott numbers of a loss share that comes in bursts."""
    r = 1.0 / mean_burst_messages
    return {"p": r * loss_probability / (1.0 - loss_probability), "r": r}


PROFILES: Mapping[str, Profile] = {
    "clean": Profile("no impairment: a plain bridge", {}),
    "lan": Profile(
        "switched Gigabit Ethernet in one building, round trip 0.4 ms",
        {way: _line(0.0002, 0.00002, 1000.0, 0.001) for way in ("forward", "backward")},
    ),
    "dsl": Profile(
        "VDSL2 access line 50/10 Mbit/s, round trip 30 ms",
        {
            "forward": _line(0.015, 0.001, 10.0, 0.1, loss={"probability": 0.001}),
            "backward": _line(0.015, 0.001, 50.0, 0.1, loss={"probability": 0.001}),
        },
    ),
    "lte": Profile(
        "LTE cell 40/15 Mbit/s, round trip 55 ms with strong jitter",
        {
            "forward": _line(0.032, 0.006, 15.0, 0.3, gilbert_elliott=_bursts(0.003, 3.0)),
            "backward": _line(0.023, 0.004, 40.0, 0.3, gilbert_elliott=_bursts(0.003, 3.0)),
        },
    ),
    "satellite": Profile(
        "geostationary satellite 25/5 Mbit/s, round trip 600 ms",
        {
            "forward": _line(0.310, 0.010, 5.0, 0.3, gilbert_elliott=_bursts(0.005, 10.0)),
            "backward": _line(0.290, 0.005, 25.0, 0.3, gilbert_elliott=_bursts(0.005, 10.0)),
        },
    ),
    "transcontinental": Profile(
        "research networks across an ocean, round trip 150 ms",
        {way: _line(0.075, 0.0005, 1000.0, 0.05, loss={"probability": 0.0001}) for way in ("forward", "backward")},
    ),
}


def known_profiles() -> str:
    """Return the profile names for an error text."""
    return ", ".join(PROFILES)
