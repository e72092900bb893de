"""`telenano session arm --return`: the tip of a rig returns to a place at a speed that is announced before.

Arming alone moves nothing: after a stop, a loss or a restart, tip and hand stay where they are, and an offset between
them remains. Returning is a separate command with numbers from the guard of the instrument. Any input ends it and the
tip stops: another command, a key, or a hand that moves or presses (`telenano.afm.safety`).
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from telenano.console.send_commands import arm_steps, send_controls
from telenano.runtime.loop.arming import ARM_TIP, return_to
from telenano.runtime.loop.commands import Command
from telenano.wire.errors import RigError
from telenano.wire.lengths import in_nm
from telenano.wire.messages import SessionEvent
from telenano.wire.nodes import TIP, Site


class WayBack(NamedTuple):
    """Return of the base: target, towards the sample > 0 [m], speed [m/s], start [m] and duration [s]."""

    place_m: float
    speed_m_per_s: float
    from_m: float
    time_s: float

    def __str__(self) -> str:
        return (
            f"the base of the tip goes from {in_nm(self.from_m)} to {in_nm(self.place_m)} at"
            f" {1e9 * self.speed_m_per_s:.4g} nm/s, for {self.time_s:.2g} s; any key or command ends it, and so does a"
            " hand that moves or presses"
        )


def go_back(
    site_file: Path,
    site: Site = "master",
    announce: Callable[[WayBack], None] = lambda way: None,
    is_wanted: Callable[[], bool] = lambda: True,
    *,
    place_m: float | None = None,
    speed_m_per_s: float | None = None,
    on_answer: Callable[[SessionEvent], None] = lambda event: None,
    issued_ns: int | None = None,
    by: str | None = None,
) -> WayBack | None:
    """Arm hand and tip where they are, then let the tip return to a place, and wait until it arrives.

    Returns the motion; None if no place is given and the instrument names none, because the tip is where the hand is.

    Args:
        site_file: The site file of the rig.
        site: The site at which the command is given.
        announce: Called with the motion before it begins.
        is_wanted: Called repeatedly; once it returns False, the tip stops where it is.
        place_m: Target of the base, towards the sample > 0 [m]; None for that of the instrument.
        speed_m_per_s: Speed [m/s]; None for that of the instrument.
        on_answer: Called with each answer of the devices.
        issued_ns: As in `send_controls`.
        by: As in `send_controls`.

    Raises:
        RigError: The command is refused, or the return ended early; the tip then stays where it is.
        ConfigError, EndpointError, RefusedError: As in `send_controls`.
    """
    issued_ns = time.monotonic_ns() if issued_ns is None else issued_ns
    # At the instrument's site the tip alone is asked: the hand was armed at its own, or the tip follows nothing.
    steps = arm_steps(site_file, site, {})
    armed = send_controls(steps, site_file, site, on_answer, is_wanted, issued_ns=issued_ns, by=by).get(TIP)
    if armed is None:
        raise RigError(f"the tip does not go back: {TIP} is not reached from the {site}'s site")
    if (way := _way_from(armed, place_m, speed_m_per_s)) is None:
        return None
    announce(way)
    back = return_to(way.place_m, way.speed_m_per_s)
    answers = send_way([back], site_file, site, on_answer, is_wanted, issued_ns=issued_ns, by=by)
    if refused := [event.text for event in answers.values() if event.kind == "refused"]:
        raise RigError(f"the tip does not go back: {'; '.join(refused)}")
    return way


def send_way(
    commands: Sequence[Command],
    site_file: Path,
    site: Site,
    on_answer: Callable[[SessionEvent], None],
    is_wanted: Callable[[], bool],
    *,
    issued_ns: int,
    by: str | None = None,
) -> dict[str, SessionEvent]:
    """Send commands as `send_controls`, of which the last moves the tip; end the motion once it is no longer wanted.

    Raises:
        RigError: The motion was ended and the tip stays where it is, or as in `send_controls`.
    """
    was_unwanted = False

    def still() -> bool:
        nonlocal was_unwanted
        was_unwanted = was_unwanted or not is_wanted()
        return not was_unwanted

    try:
        return send_controls(commands, site_file, site, on_answer, still, issued_ns=issued_ns, by=by)
    except (RigError, KeyboardInterrupt) as error:
        if not was_unwanted and isinstance(error, RigError):
            raise
        # Any other command ends the motion of the base. Arming moves nothing, and because it has the time of the
        # original command, an emergency stop that came meanwhile makes it void.
        send_controls([ARM_TIP], site_file, site, on_answer, issued_ns=issued_ns, by=by)
        raise RigError("going back was ended: the tip stays where it is") from error


def _way_from(armed: SessionEvent, place_m: float | None, speed_m_per_s: float | None) -> WayBack | None:
    """Return the motion that the instrument proposes, with the place and speed that a person gave instead.

    None if there is no target. Raises RigError if arming was refused or no speed is known.
    """
    if armed.kind == "refused":
        raise RigError(f"the tip does not go back: {armed.text}")
    stated = {key: armed.data.get(key) for key in ("return_place_m", "return_speed_m_per_s", "base_position_m")}
    place, speed, from_m = (float(value) if isinstance(value, int | float) else None for value in stated.values())
    place = place if place_m is None else place_m
    speed = speed if speed_m_per_s is None else speed_m_per_s
    if place is None or from_m is None:
        return None
    if speed is None:
        raise RigError("the instrument states no speed of its own for this way: state one with --speed")
    return WayBack(place, speed, from_m, abs(place - from_m) / speed)
