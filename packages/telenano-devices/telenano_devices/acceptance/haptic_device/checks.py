"""The checks of a take of a device that takes a force; a check names what it lacks, such as buttons or a mass."""

from collections.abc import Callable
from typing import Any

import numpy as np

from telenano.extend.hands import Capabilities, Gate
from telenano_devices.acceptance.haptic_device.take import (
    AXES,
    LEVELS,
    MOST_WITHOUT_STOP_N,
    ROW,
    STANDARD_GRAVITY_M_PER_S2,
    Facts,
)
from telenano_devices.acceptance.take import PERIOD_S, Kind, Result, Rows, Take, drift, median_age, noise, passes
from telenano_devices.impedance.coupling import CouplingSettings

# All tolerances are provisional until takes of real devices are there.
# The largest deviation from the declared rate, as a share of it.
RATE_SHARE = 0.05
# The largest share of steps that are more than half a period late.
LATE_SHARE = 0.01
# The largest median age of a sample.
AGE_S = 5e-3
# The longest silence while the cable is plugged in.
GAP_S = 0.05
# The limits of noise and drift of the handle at rest.
NOISE_M = 5e-5
DRIFT_M = 2e-4
RESOLUTION_M = 1e-4
# The motion must reach this share of the declared workspace on each axis.
REACHED = 0.6
# A motion over more than this share of the declared workspace shows a wrong scale of positions.
BEYOND = 1.05
# The least share of a motion along an axis that must lie on that axis.
AXIS_SHARE = 0.7
# The largest deviation of the force that holds a mass from its weight, as a share of it.
FORCE_SHARE = 0.1
# A stiffness at which the held handle swings by more than this is too high for the device.
BUZZ_M = 1e-4
# The least motion of the handle along a force.
MOVED_M = 2e-4

Check = Callable[[Take[Facts]], tuple[Result, str]]


def _never(gate: int) -> Check:
    def check(take: Take[Facts]) -> tuple[Result, str]:
        times = take.rows["time_s"][take.rows["gate"] == gate]
        return ("fail", f"at {times[0]:.2f} s: {Gate(gate).text}") if len(times) else ("pass", "never")

    return check


def _present(take: Take[Facts]) -> Rows:
    """Return the rows outside the step in which the cable is out."""
    out = [number for number, step in enumerate(take.steps) if step.name == "cable"]
    rows: Rows = take.rows[~np.isin(take.rows["step"], out)]
    return rows


def _rate(take: Take[Facts]) -> tuple[Result, str]:
    rows = take.of("slow")
    found_hz = (rows["counter"][-1] - rows["counter"][0]) / (rows["time_s"][-1] - rows["time_s"][0])
    return passes(abs(found_hz / take.facts.device.rate_hz - 1.0) <= RATE_SHARE), f"{found_hz:.0f} Hz"


def _jitter(take: Take[Facts]) -> tuple[Result, str]:
    rows = _present(take)
    steps = max(1, rows["counter"][-1] - rows["counter"][0])
    share = (rows["late"][-1] - rows["late"][0]) / steps
    return passes(share <= LATE_SHARE), f"{100.0 * share:.2f} % of the steps late"


def _age(take: Take[Facts]) -> tuple[Result, str]:
    return median_age(_present(take), AGE_S)


def _gaps(take: Take[Facts]) -> tuple[Result, str]:
    rows = _present(take)
    longest_s = float(rows["age_s"].max(initial=0.0))
    good = longest_s <= GAP_S and not rows["lost"].any()
    message = "" if good or not take.facts.device_messages else f": {take.facts.device_messages[0]}"
    return passes(good), f"{1e3 * longest_s:.0f} ms{message}"


def _fresh(take: Take[Facts]) -> tuple[Result, str]:
    changes = np.any(np.diff(take.of("fast")["place_m"], axis=0) != 0.0, axis=1)
    share = float(changes.mean())
    moved = float(np.ptp(take.of("fast")["place_m"], axis=0).max())
    if moved < 0.2 * take.facts.device.workspace_max_m:
        return "retake", f"the handle moved by {1e3 * moved:.0f} mm only"
    wanted = 0.5 * min(1.0, take.facts.device.rate_hz * PERIOD_S)
    return passes(share >= wanted), f"{100.0 * share:.0f} % of the samples are new"


def _quiet(take: Take[Facts]) -> Rows | str:
    """Return the positions of the step *rest*, or a sentence if the handle was moved."""
    places: Rows = take.of("rest")["place_m"]
    return "the handle was moved in the step rest" if float(np.ptp(places, axis=0).max()) > 0.02 else places


def _noise(take: Take[Facts]) -> tuple[Result, str]:
    return noise(_quiet(take), NOISE_M, "{:.1f} um", 1e6)


def _drift(take: Take[Facts]) -> tuple[Result, str]:
    return drift(_quiet(take), DRIFT_M, "{:.0f} um", 1e6)


def _resolution(take: Take[Facts]) -> tuple[Result, str]:
    changes = np.abs(np.diff(take.of("slow")["place_m"], axis=0))
    if not changes.any():
        return "retake", "the handle was not moved in the step slow"
    smallest = [float(axis[axis > 0.0].min()) if axis.any() else 0.0 for axis in changes.T]
    return passes(max(smallest) <= RESOLUTION_M), f"smallest steps {_um(smallest)} um"


def _um(values: list[float]) -> str:
    return ", ".join(f"{1e6 * value:.3g}" for value in values)


def _shares(take: Take[Facts]) -> list[float]:
    """Return the extent of the two sweeps over the declared workspace, for each axis."""
    places = np.concatenate((take.of("slow")["place_m"], take.of("fast")["place_m"]))
    (x0, x1), (y0, y1) = take.facts.device.lateral_m
    declared = [x1 - x0, y1 - y0, take.facts.device.workspace_max_m - take.facts.device.workspace_min_m]
    return [reached / d for reached, d in zip(np.ptp(places, axis=0).tolist(), declared, strict=True)]


def _workspace(take: Take[Facts]) -> tuple[Result, str]:
    shares = _shares(take)
    text = ", ".join(f"{axis} {100.0 * share:.0f} %" for axis, share in zip(AXES, shares, strict=True))
    return ("retake" if min(shares) < REACHED else "pass"), text


def _scale(take: Take[Facts]) -> tuple[Result, str]:
    shares = _shares(take)
    if min(shares) < REACHED:
        return "cannot say", "not enough of the workspace was reached"
    return passes(max(shares) <= BEYOND), f"at most {100.0 * max(shares):.0f} % of the declared workspace"


def _sign(step: str, axis: int) -> Check:
    def check(take: Take[Facts]) -> tuple[Result, str]:
        places = take.of(step)["place_m"]
        ways = places - places[: max(1, len(places) // 20)].mean(axis=0)
        furthest = ways[np.argmax(np.linalg.norm(ways, axis=1))]
        size = float(np.linalg.norm(furthest))
        if size < 0.1 * take.facts.device.workspace_max_m:
            return "retake", f"the handle moved by {1e3 * size:.1f} mm only"
        share = float(furthest[axis]) / size
        furthest_text = ", ".join(f"{name} {1e3 * way:+.0f}" for name, way in zip(AXES, furthest, strict=True))
        return passes(share >= AXIS_SHARE), f"{furthest_text} mm"

    return check


def _force_sign(take: Take[Facts]) -> tuple[Result, str]:
    rows = take.of("hold")
    # Only the first half counts: with the raised stiffness of the second, the coupling may swing against the force.
    if (rows["gate"][: len(rows) // 2] == Gate.RUNAWAY).any():
        return "fail", Gate.RUNAWAY.text
    wrong: list[str] = []
    good = True
    for axis, name in enumerate(AXES):
        pushed = rows["asked_n"][:, axis] > 0.0
        engaged = pushed & (rows["gate"] == Gate.ACTIVE)
        if engaged.sum() < 0.5 * max(1, pushed.sum()) or not pushed.any():
            return "retake", f"the device was not driven: {_why(rows)}"
        first = int(np.flatnonzero(pushed)[0])
        last = np.flatnonzero(pushed)[-max(1, int(pushed.sum()) // 3) :]
        moved_m = float(rows["place_m"][last, axis].mean() - rows["place_m"][first, axis])
        good &= moved_m > MOVED_M
        wrong.append(f"{name} {1e3 * moved_m:+.2f}")
    return passes(good), f"{', '.join(wrong)} mm of motion for a force towards +"


def _why(rows: Rows) -> str:
    gates, counts = np.unique(rows["gate"][rows["gate"] != Gate.ACTIVE], return_counts=True)
    return Gate(int(gates[np.argmax(counts)])).text if len(gates) else "no force was asked for"


def _force_scale(take: Take[Facts]) -> tuple[Result, str]:
    rows = take.of("mass")
    if not len(rows):
        return "cannot say", "no mass was hung at the handle (--mass)"
    late = rows[-len(rows) // 4 :]
    if (late["gate"] != Gate.ACTIVE).any():
        return "retake", f"the device was not driven: {_why(rows)}"
    wanted_n = take.facts.mass_kg * STANDARD_GRAVITY_M_PER_S2
    found_n = float(late["force_n"][:, 2].mean())
    return passes(abs(found_n / wanted_n - 1.0) <= FORCE_SHARE), f"{found_n:.3f} N for a weight of {wanted_n:.3f} N"


def _stiffness(take: Take[Facts]) -> tuple[Result, str]:
    rows, best = take.of("hold"), 0.0
    rows = rows[len(rows) // 2 :]
    swung = (rows["gate"] == Gate.RUNAWAY).any()
    if (rows["gate"] == Gate.ACTIVE).mean() < 0.5 and not swung:
        return "retake", f"the device was not driven: {_why(rows)}"
    for level in LEVELS:
        rows_of_level = rows[rows["level"] == level]
        if (
            _buzz_m(rows_of_level[len(rows_of_level) * 6 // 10 :]["place_m"][:, 2]) > BUZZ_M
            or (rows_of_level["gate"] != Gate.ACTIVE).any()
        ):
            break
        best = level
    stiffness = take.facts.settings.stiffness_n_per_m[2]
    beyond = ", the most that was tried" if best == LEVELS[-1] else ", above it the device oscillated" if swung else ""
    text = f"quiet up to {best * stiffness:.0f} N/m{beyond}"
    return passes(best >= 1.0), text


def _buzz_m(places: Rows) -> float:
    """Return the standard deviation of the motion faster than some 15 Hz [m]."""
    width = 33
    if len(places) < 2 * width:
        return 0.0
    slow = np.convolve(places, np.ones(width) / width, mode="valid")
    return float((places[width // 2 : width // 2 + len(slow)] - slow).std())


def _limits(take: Take[Facts]) -> tuple[Result, str]:
    forces = take.rows["force_n"]
    most = float(np.linalg.norm(forces, axis=1).max())
    jump = float(np.linalg.norm(np.diff(forces, axis=0), axis=1).max())
    asked = float(np.linalg.norm(take.rows["asked_n"], axis=1).max())
    pushed = np.linalg.norm(take.rows["asked_n"], axis=1) > 0.0
    held = np.linalg.norm(forces[pushed], axis=1)
    typical = float(np.median(held)) if len(held) else 0.0
    good = most <= take.facts.settings.max_force_n * (1.0 + 1e-9) and typical <= 1.5 * asked
    return passes(
        good
    ), f"at most {most:.2f} N, {typical:.2f} N where {asked:.2f} N were asked for, steps of {jump:.2f} N"


def _buttons(take: Take[Facts]) -> tuple[Result, str]:
    names, pressed = take.facts.device.buttons, take.of("button")["buttons"]
    if not names:
        return "cannot say", "the device declares no buttons"
    seen = [(bool((pressed >> bit & 1).any()), bool((pressed >> bit & 1).all())) for bit in range(len(names))]
    if stuck := [name for name, (_, always) in zip(names, seen, strict=True) if always]:
        return "fail", f"always pressed: {', '.join(stuck)}"
    if missing := [name for name, (ever, _) in zip(names, seen, strict=True) if not ever]:
        result: Result = "retake" if len(missing) == len(names) else "fail"
        return result, f"never pressed: {', '.join(missing)}"
    return "pass", f"pressed and let go: {', '.join(names)}"


def _deadman(take: Take[Facts]) -> tuple[Result, str]:
    if not take.facts.device.deadman:
        return "cannot say", "the device declares no dead-man button"
    rows, bit = take.of("button"), take.facts.device.buttons.index(take.facts.device.deadman)
    held = (rows["buttons"] >> bit & 1).astype(bool)
    if len(take.of("hold")) and not (take.rows["buttons"] >> bit & 1).any():
        return "fail", f"{take.facts.device.deadman} was never heard, while it had to be held: its grip may be asleep"
    if held.all() or not held.any():
        return "retake", f"{take.facts.device.deadman} was not both held and let go"
    # A tenth of a second after the button was released there must be no force.
    late = np.convolve(~held, np.ones(101), mode="full")[: len(held)] >= 101
    driven = rows["gate"][late] == Gate.ACTIVE
    seen = bool((rows["gate"] == Gate.DEADMAN).any())
    return passes(seen and not driven.any()), "no force without it" if seen else "the device is driven without it"


def _cable(take: Take[Facts]) -> tuple[Result, str]:
    rows = take.of("cable")
    lost = rows["lost"]
    if not lost.any():
        still_s = _longest_still_s(rows["place_m"])
        if still_s > 0.1 * len(rows) * PERIOD_S:
            return "fail", f"the readings stood still for {still_s:.1f} s and no loss was reported"
        return "retake", "the cable was not pulled out"
    later = np.flatnonzero(lost)
    driven = bool(np.linalg.norm(rows["force_n"][lost & (rows["age_s"] > GAP_S)], axis=1).any())
    back = bool((~lost[later[-1] :]).any())
    if not back:
        return "retake", "the device did not come back before the step ended"
    return passes(
        not driven
    ), f"lost for {len(later) * PERIOD_S:.2f} s, force while lost: {'yes' if driven else 'none'}"


def _longest_still_s(places: Rows) -> float:
    still, longest = 0, 0
    for same in np.all(np.diff(places, axis=0) == 0.0, axis=1):
        still = still + 1 if same else 0
        longest = max(longest, still)
    return longest * PERIOD_S


def _orientation(take: Take[Facts]) -> tuple[Result, str]:
    if not take.facts.device.has_orientation:
        return "cannot say", "the device declares no orientation"
    norms = np.linalg.norm(take.rows["orientation"], axis=1)
    worst = float(np.abs(norms - 1.0).max())
    return passes(worst <= 1e-3), f"norm off by {worst:.2g} at most"


def _stop(take: Take[Facts]) -> tuple[Result, str]:
    if take.facts.independent_stop:
        return "pass", take.facts.independent_stop
    most = take.facts.settings.max_force_n
    return passes(most <= MOST_WITHOUT_STOP_N), f"no emergency stop is stated, and the device gives up to {most:.3g} N"


_CHECKS: tuple[tuple[str, Check, str, tuple[str, ...]], ...] = (
    ("finite positions", _never(Gate.NOT_A_NUMBER), "no position that is not a number", ()),
    ("rate", _rate, f"the declared rate within {100 * RATE_SHARE:.0f} %", ("slow",)),
    ("jitter", _jitter, f"at most {100 * LATE_SHARE:.0f} % of the steps more than half a period late", ("rest",)),
    ("age of samples", _age, f"{1e3 * AGE_S:.0f} ms at most in the median", ("rest",)),
    ("gaps", _gaps, f"no silence of more than {1e3 * GAP_S:.0f} ms but for the cable", ("rest",)),
    ("fresh positions", _fresh, "half of the samples new, or as many as the rate gives", ("fast",)),
    ("no jumps", _never(Gate.JUMP), "no jump from one sample to the next that a hand cannot make", ()),
    ("no frozen readings", _never(Gate.FROZEN), "a position that changes when the force changes", ("hold",)),
    ("noise at rest", _noise, f"{1e6 * NOISE_M:.0f} um at most", ("rest",)),
    ("drift at rest", _drift, f"{1e6 * DRIFT_M:.0f} um at most", ("rest",)),
    ("resolution", _resolution, f"{1e6 * RESOLUTION_M:.0f} um at most", ("slow",)),
    ("workspace", _workspace, f"{100 * REACHED:.0f} % of the declared workspace on each axis", ("slow", "fast")),
    ("scale of positions", _scale, f"no more than {100 * BEYOND:.0f} % of the declared workspace", ("slow", "fast")),
    ("sign of x", _sign("right", 0), "+x when pushed to the right", ("right",)),
    ("sign of y", _sign("forward", 1), "+y when pushed forward", ("forward",)),
    ("sign of z", _sign("up", 2), "+z when lifted", ("up",)),
    ("sign of forces", _force_sign, "motion along the force on each axis", ("hold",)),
    ("scale of forces", _force_scale, f"the weight of the mass within {100 * FORCE_SHARE:.0f} %", ("mass",)),
    ("rendering stiffness", _stiffness, "no buzz at the stiffness of the coupling", ("hold",)),
    ("limits of force", _limits, "no more than the clamp, and what was asked for", ("hold",)),
    ("buttons", _buttons, "each pressed and let go", ("button",)),
    ("dead-man", _deadman, "no force within 0.1 s without it", ("button",)),
    ("cable loss", _cable, "reported, and no force while lost", ("cable",)),
    ("orientation", _orientation, "unit quaternions", ()),
    ("independent stop", _stop, f"stated for every device of more than {MOST_WITHOUT_STOP_N:g} N", ()),
)


def _facts_of(device: Any, settings: Any, **values: Any) -> Facts:
    return Facts(Capabilities(**device), CouplingSettings(**settings), **values)


HAPTIC_DEVICE = Kind(ROW, _facts_of, _CHECKS)
