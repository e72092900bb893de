"""The checks of a take of a handle; a check that cannot judge names the reason, such as a missing hand or mode."""

from collections.abc import Callable
from typing import Any

import numpy as np

from telenano.extend.hands import MODE_POSITION, Capabilities
from telenano_devices.acceptance.handle.take import ROW, STATUSES, Facts
from telenano_devices.acceptance.take import PERIOD_S, Kind, Result, Rows, Take, drift, median_age, noise, passes

# All tolerances are provisional until takes of real handles are there.
# The largest share of bad or missing frames.
BAD_SHARE = 1e-3
# The largest excess of the median age of a sample over the declared latency.
AGE_S = 3e-3
# The longest silence.
GAP_S = 0.05
# The limits of noise, drift and zero of the handle at rest, without a hand on it.
NOISE_M = 5e-5
DRIFT_M = 2e-4
FORCE_NOISE_N = 0.05
ZERO_N = 0.2
# A push by less than this force says nothing about the sign of forces.
FELT_N = 0.3
# A motion shorter than this says nothing about the sign of positions.
MOVED_M = 2e-4
# The largest error of following, as a share of the amplitude of the motion.
FOLLOW_SHARE = 0.2
# The largest standard deviation of the position of a held handle above some 15 Hz.
BUZZ_M = 1e-4
# A held handle may yield by this plus HELD_FACTOR times the force over its declared stiffness.
HELD_M = 1e-3
HELD_FACTOR = 2.0
_LOST = STATUSES.index("lost")
Check = Callable[[Take[Facts]], tuple[Result, str]]


def _attached(take: Take[Facts]) -> Rows:
    """Return the rows of the steps in which the handle is attached and gets commands."""
    names = [step.name for step in take.steps]
    rows: Rows = take.rows[~np.isin(take.rows["step"], [names.index("silence"), names.index("cable")])]
    return rows


def _losses(take: Take[Facts]) -> tuple[Result, str]:
    rows = _attached(take)
    lost = rows["status"] == _LOST
    if lost.any():
        message = next(iter(take.facts.device_messages), "see its events")
        return "fail", f"lost after {rows['time_s'][lost][0]:.2f} s: {message}"
    return "pass", "never"


def _frames(take: Take[Facts]) -> tuple[Result, str]:
    rows = _attached(take)
    bad, missed = (int(rows[name][-1] - rows[name][0]) for name in ("bad", "missed"))
    return passes(bad + missed <= BAD_SHARE * len(rows)), f"{bad} bad and {missed} missing of {len(rows)}"


def _age(take: Take[Facts]) -> tuple[Result, str]:
    return median_age(_attached(take), take.facts.device.latency_s + AGE_S)


def _gaps(take: Take[Facts]) -> tuple[Result, str]:
    longest_s = float(_attached(take)["age_s"].max(initial=0.0))
    return passes(longest_s <= GAP_S), f"{1e3 * longest_s:.0f} ms"


def _estop(take: Take[Facts]) -> tuple[Result, str]:
    pressed = take.rows["time_s"][take.rows["estop"]]
    return passes(not len(pressed)), f"pressed after {pressed[0]:.2f} s" if len(pressed) else "never pressed"


def _quiet(take: Take[Facts]) -> Rows | str:
    rows = take.of("rest")
    return "the handle was moved in the step rest" if float(np.ptp(rows["place_m"])) > 5e-3 else rows["place_m"]


def _noise(take: Take[Facts]) -> tuple[Result, str]:
    return noise(_quiet(take), NOISE_M, "{:.1f} um", 1e6)


def _drift(take: Take[Facts]) -> tuple[Result, str]:
    return drift(_quiet(take), DRIFT_M, "{:.0f} um", 1e6)


def _force_noise(take: Take[Facts]) -> tuple[Result, str]:
    return noise(take.of("rest")["hand_n"], FORCE_NOISE_N, "{:.3f} N", 1.0)


def _zero(take: Take[Facts]) -> tuple[Result, str]:
    mean_n = float(take.of("rest")["hand_n"].mean())
    return passes(abs(mean_n) <= ZERO_N), f"{mean_n:.3f} N without a hand on it"


def _force_sign(take: Take[Facts]) -> tuple[Result, str]:
    forces = take.of("push")["hand_n"]
    furthest_n = float(forces[np.argmax(np.abs(forces))])
    if abs(furthest_n) < FELT_N:
        return "retake", f"the handle was pushed by {furthest_n:.2f} N only"
    return passes(furthest_n > 0.0), f"{furthest_n:+.2f} N"


def _place_sign(take: Take[Facts]) -> tuple[Result, str]:
    places = take.of("push")["place_m"]
    ways = places - places[0]
    furthest_m = float(ways[np.argmax(np.abs(ways))])
    if abs(furthest_m) < MOVED_M:
        return "cannot say", "undriven, it does not move when it is pushed"
    return passes(furthest_m > 0.0), f"{1e3 * furthest_m:+.2f} mm"


def _follows(take: Take[Facts]) -> tuple[Result, str]:
    rows = take.of("follow")
    if MODE_POSITION not in take.facts.device.modes:
        return "cannot say", "the handle has no position mode"
    late = max(1, round(take.facts.device.latency_s / PERIOD_S))
    driven = rows[rows["is_driven"]]
    if len(driven) <= 2 * late:
        return "retake", "the handle was not driven"
    error_m = driven["place_m"][late:] - driven["asked_m"][:-late]
    worst_m, amplitude_m = float(np.abs(error_m).max()), take.facts.amplitude_m
    text = f"off by {1e3 * worst_m:.2f} mm at most, of {1e3 * amplitude_m:.2f} mm"
    return passes(worst_m <= FOLLOW_SHARE * amplitude_m), text


def _buzz(take: Take[Facts]) -> tuple[Result, str]:
    places, width = take.of("hold")["place_m"], 33
    if len(places) < 2 * width:
        return "retake", "the step hold was too short"
    slow = np.convolve(places, np.ones(width) / width, mode="valid")
    found_m = float((places[width // 2 : width // 2 + len(slow)] - slow).std())
    return passes(found_m <= BUZZ_M), f"{1e6 * found_m:.1f} um of motion above about 15 Hz, standard deviation"


def _limits(take: Take[Facts]) -> tuple[Result, str]:
    most_n, limit_n = float(np.abs(take.rows["motor_n"]).max()), take.facts.max_drive_n
    return passes(most_n <= 1.01 * limit_n), f"{most_n:.2f} N at most, the limit is {limit_n:.2f} N"


def _holds(take: Take[Facts]) -> tuple[Result, str]:
    rows, device = take.of("hold"), take.facts.device
    rows = rows[rows["is_driven"]]
    if MODE_POSITION not in device.modes:
        return "cannot say", "the handle has no position mode"
    if not len(rows) or float(np.abs(rows["hand_n"]).max()) < FELT_N:
        return "retake", "the handle was not pushed in the step hold"
    worst_m, most_n = float(np.abs(rows["place_m"] - rows["asked_m"]).max()), float(np.abs(rows["hand_n"]).max())
    wanted_m = HELD_M + HELD_FACTOR * most_n / device.max_stiffness_n_per_m
    return passes(worst_m <= wanted_m), f"{1e3 * worst_m:.2f} mm under {most_n:.2f} N"


def _watchdog(take: Take[Facts]) -> tuple[Result, str]:
    text = f"{1e3 * take.facts.watchdog_s:.0f} ms are allowed"
    if take.of("silence")["tripped"].any():
        return "pass", f"switched off by itself, {text}"
    return "fail", f"it has not reported that it was off, {text}"


def _cable(take: Take[Facts]) -> tuple[Result, str]:
    lost = take.of("cable")["status"] == _LOST
    if not lost.any():
        return "retake", "the cable was not pulled out"
    if lost[-1]:
        return "retake", "the handle did not come back before the step ended"
    return "pass", f"reported for {lost.sum() * PERIOD_S:.2f} s, and it came back"


_CHECKS: tuple[tuple[str, Check, str, tuple[str, ...]], ...] = (
    ("losses", _losses, "none while it is attached", ("rest",)),
    ("frames", _frames, f"at most {1e3 * BAD_SHARE:.0f} in 1000 bad or missing", ("rest",)),
    ("age of samples", _age, f"the declared latency and {1e3 * AGE_S:.0f} ms at most, in the median", ("rest",)),
    ("gaps", _gaps, f"no silence of more than {1e3 * GAP_S:.0f} ms", ("rest",)),
    ("emergency stop", _estop, "not pressed", ("rest",)),
    ("noise at rest", _noise, f"{1e6 * NOISE_M:.0f} um at most", ("rest",)),
    ("drift at rest", _drift, f"{1e6 * DRIFT_M:.0f} um at most", ("rest",)),
    ("noise of the force", _force_noise, f"{FORCE_NOISE_N:g} N at most", ("rest",)),
    ("zero of the force", _zero, f"{ZERO_N:g} N at most without a hand on it", ("rest",)),
    ("sign of the force", _force_sign, "positive when pushed towards the sample", ("push",)),
    ("sign of places", _place_sign, "growing towards the sample", ("push",)),
    ("following", _follows, f"within {100 * FOLLOW_SHARE:.0f} % of the motion", ("follow",)),
    ("limits of force", _limits, "no more than the drive may give", ("follow",)),
    ("holding", _holds, "in place, apart from the give of its servo", ("hold",)),
    ("quiet hold", _buzz, f"{1e6 * BUZZ_M:.0f} um of buzz at most", ("hold",)),
    ("watchdog", _watchdog, "the drive is off while nothing is sent", ("silence",)),
    ("cable loss", _cable, "reported, and it comes back", ("cable",)),
)


def _facts_of(device: Any, **facts: Any) -> Facts:
    return Facts(Capabilities(**device), **facts)


HANDLE = Kind(ROW, _facts_of, _CHECKS)
