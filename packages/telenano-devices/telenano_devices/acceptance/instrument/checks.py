"""The checks of a take of an instrument; a check names what it lacks, such as a guard, or a sample stiff enough."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from telenano.extend.instruments import SafetyParams
from telenano_devices.acceptance.instrument.take import PULLED, ROW, STATUSES, Facts
from telenano_devices.acceptance.take import Kind, Result, Rows, Take, drift, median_age, noise, passes

# All tolerances are provisional until takes of real instruments are there.
# The least rate of samples, as a share of the declared rate.
RATE_SHARE = 0.7
# The largest excess of the median age of a sample over the declared latency.
AGE_S = 3e-3
# The largest excess of a silence over the declared latency.
GAP_S = 0.05
# The latency may exceed the declared one by this share of it, or by LATENCY_S if that is more.
LATENCY_SHARE = 0.25
LATENCY_S = 2e-3
# The largest noise and drift at rest, as a share of the force that counts as contact.
NOISE_SHARE = 0.3
# The base may be off the requested position by this share of its travel plus RANGE_M.
RANGE_SHARE = 0.01
RANGE_M = 1e-9
# Steps in contact must show a stiffness between these multiples of the cantilever's.
SCALE_MOST = 1.15
SCALE_LEAST = 0.3
# The instrument must be retracted again within this time after its link came back.
BACK_S = 5.0
_OK = STATUSES.index("ok")
_LOST = STATUSES.index("lost")

Check = Callable[[Take[Facts]], tuple[Result, str]]


def _driven(take: Take[Facts]) -> Rows:
    """Return the rows of the steps in which the instrument is driven: those before the silence."""
    rows: Rows = take.rows[take.rows["step"] < 4]
    return rows


def _losses(take: Take[Facts]) -> tuple[Result, str]:
    rows = _driven(take)
    lost = rows["status"] == _LOST
    if lost.any():
        return "fail", f"lost after {rows['time_s'][lost][0]:.2f} s: {take.facts.stopped or 'see its events'}"
    return "pass", "never"


def _rate(take: Take[Facts]) -> tuple[Result, str]:
    # Only the approach shows the rate: while the base stands, a controller may publish the same values as new ones.
    rows = take.of("approach")
    if len(rows) < 200:
        return "retake", take.facts.stopped or "the approach was too short"
    found_hz = float((rows["fresh"][-1] - rows["fresh"][0]) / (rows["time_s"][-1] - rows["time_s"][0]))
    return passes(found_hz >= RATE_SHARE * take.facts.sample_hz), f"{found_hz:.0f} Hz of {take.facts.sample_hz:.0f} Hz"


def _age(take: Take[Facts]) -> tuple[Result, str]:
    return median_age(_driven(take), take.facts.latency_s + AGE_S)


def _gaps(take: Take[Facts]) -> tuple[Result, str]:
    rows = _driven(take)
    longest_s = float(rows["age_s"].max()) if len(rows) else math.inf
    return passes(longest_s <= GAP_S + take.facts.latency_s), f"{1e3 * longest_s:.0f} ms"


def _in_range(take: Take[Facts]) -> tuple[Result, str]:
    rows = _driven(take)
    beyond = ~rows["in_range"]
    if beyond.any():
        return (
            "fail",
            f"saturated after {rows['time_s'][beyond][0]:.2f} s, with the base at {rows['base_m'][beyond][0]:.4g} m",
        )
    return "pass", f"at most {np.abs(rows['value']).max():.4g}, the input's own unit"


def _quiet(take: Take[Facts]) -> Rows | str:
    """Return the forces of the step *rest* after its first half second; if too few, why the motion ended."""
    forces: Rows = take.of("rest")["force_n"][500:]
    return forces if len(forces) >= 1000 else take.facts.stopped


def _noise(take: Take[Facts]) -> tuple[Result, str]:
    return noise(_quiet(take), NOISE_SHARE * take.facts.contact_force_n, "{:.3g} nN", 1e9)


def _drift(take: Take[Facts]) -> tuple[Result, str]:
    return drift(_quiet(take), NOISE_SHARE * take.facts.contact_force_n, "{:.3g} nN", 1e9)


def _zero(take: Take[Facts]) -> tuple[Result, str]:
    forces = _quiet(take)
    if isinstance(forces, str):
        return "fail", f"not free where it is retracted: {forces}"
    mean_n = float(forces.mean())
    return passes(abs(mean_n) <= take.facts.contact_force_n), f"{1e9 * mean_n:.3g} nN with the tip retracted"


def _range(take: Take[Facts]) -> tuple[Result, str]:
    rows, limits = take.of("range"), take.facts.limits
    far, near = limits.base_min_m, limits.retract_position_m
    stood = [rows["base_m"][np.abs(rows["asked_m"] - end) < 1e-12][-200:] for end in (far, near)]
    if min(len(each) for each in stood) < 200:
        return "retake", take.facts.stopped or "the base was not moved"
    ends = [float(np.median(each)) for each in stood]
    errors = [abs(measured - wanted) for measured, wanted in zip(ends, (far, near), strict=True)]
    good = max(errors) <= RANGE_M + RANGE_SHARE * (near - far)
    furthest = float(take.rows["base_m"].max())
    return passes(good), (
        f"{1e9 * ends[0]:.4g} to {1e9 * ends[1]:.4g} nm read where {1e9 * far:.4g} to {1e9 * near:.4g} nm were sent;"
        f" towards the sample {1e9 * furthest:.4g} of {1e9 * limits.base_max_m:.4g} nm"
    )


def _surface(take: Take[Facts]) -> tuple[Result, str]:
    rows = take.of("contact")
    if not len(rows):
        return "retake", take.facts.stopped or "the base did not reach the sample"
    return "pass", f"pressed by {1e9 * take.facts.press_n:.3g} nN with the base at {1e9 * rows['asked_m'].max():.4g} nm"


class _Edges:
    """The steps in contact: changes of base [m] and force [N] from edge to edge, and delays of the force [s]."""

    def __init__(self, take: Take[Facts]) -> None:
        rows = take.of("contact")
        asked = rows["asked_m"]
        turns = np.flatnonzero(np.diff(asked)) + 1
        # A step that the guard's speed limit spreads over several rows is one edge.
        self.starts = turns[np.diff(turns, prepend=-100) > 20]
        befores, ends = np.append(0, self.starts)[:-1], np.append(self.starts, len(rows))[1:]
        self.base_m, self.force_n, self.late_s = [], [], []
        for before, start, end in zip(befores, self.starts, ends, strict=True):
            old, new = slice((before + start) // 2, start), slice((start + end) // 2, end)
            base, force = (float(rows[name][new].mean() - rows[name][old].mean()) for name in ("base_m", "force_n"))
            self.base_m.append(base)
            self.force_n.append(force)
            half = float(rows["force_n"][old].mean()) + 0.5 * force
            crossed = np.flatnonzero((rows["force_n"][start:end] - half) * np.sign(force) >= 0.0)
            if len(crossed):
                # The base is sent at the beginning of a row, and the answer is read at its end.
                self.late_s.append(float(rows["time_s"][start + crossed[0]] - rows["time_s"][start]))

    @property
    def slope_n_per_m(self) -> float:
        base = np.array(self.base_m)
        return float(np.dot(base, self.force_n) / np.dot(base, base)) if base.any() else math.nan


def _sign(take: Take[Facts]) -> tuple[Result, str]:
    edges = _Edges(take)
    slope = edges.slope_n_per_m
    if len(edges.starts) < 10:
        return "fail" if take.facts.stopped == PULLED else "retake", take.facts.stopped or "the base did not move"
    if math.isnan(slope):
        return "fail", "the position that was read did not follow the base"
    return passes(slope > 0.0), f"{slope:.3g} N for a metre towards the sample"


def _scale(take: Take[Facts]) -> tuple[Result, str]:
    edges, stiffness = _Edges(take), take.facts.stiffness_n_per_m
    share = edges.slope_n_per_m / stiffness
    if len(edges.starts) < 10 or not share > 0.0:
        return "retake", take.facts.stopped or "the force did not follow the base"
    text = f"{100.0 * share:.0f} % of the {stiffness:g} N/m of the cantilever"
    if share > SCALE_MOST:
        return "fail", text
    return ("pass", text) if share >= SCALE_LEAST else ("cannot say", f"{text}: the sample is soft, or the scale wrong")


def _latency(take: Take[Facts]) -> tuple[Result, str]:
    edges, declared = _Edges(take), take.facts.latency_s
    if len(edges.late_s) < 10:
        return "retake", take.facts.stopped or "the force did not follow the base"
    mean_s = float(np.mean(edges.late_s))
    good = mean_s <= declared + max(LATENCY_S, LATENCY_SHARE * declared)
    return passes(good), f"{1e3 * mean_s:.1f} ms in the mean, {1e3 * max(edges.late_s):.1f} ms at most"


def _limit(take: Take[Facts]) -> tuple[Result, str]:
    most, limit = float(take.rows["force_n"].max()), take.facts.limits.force_limit_n
    return passes(most <= limit), f"{1e9 * most:.3g} nN at most, the limit is {1e9 * limit:.3g} nN"


def _watchdog(take: Take[Facts]) -> tuple[Result, str]:
    facts = take.facts
    before, after = facts.retractions
    if not facts.heartbeat_s:
        return "cannot say", "nothing retracts the tip when this rig is silent, as declared: a person has to stand by"
    if not facts.silent_s:
        return "retake", facts.stopped
    text = f"{1e3 * facts.silent_s:.0f} ms of silence, {1e3 * facts.heartbeat_s:.0f} ms are allowed"
    if before is None or after is None:
        return "fail", f"it does not count its retractions; {text}"
    return passes(after > before), f"{'retracted' if after > before else 'not retracted'} within {text}"


def _back(take: Take[Facts]) -> tuple[Result, str]:
    rows = take.of("back")
    if not len(rows):
        return "retake", take.facts.stopped or "the motion ended before this step"
    lost = np.flatnonzero(rows["status"] == _LOST)
    there_s = float(rows["time_s"][lost[-1] + 1] - rows["time_s"][0]) if len(lost) and lost[-1] + 1 < len(rows) else 0.0
    if len(lost) and lost[-1] + 1 == len(rows):
        return "fail", "the instrument did not answer again"
    at_m, safe_m = float(rows["base_m"][-1]), take.facts.limits.retract_position_m
    good = there_s <= BACK_S and at_m <= safe_m + RANGE_M and rows["status"][-1] == _OK
    return passes(good), f"after {there_s:.2f} s, with the base at {1e9 * at_m:.4g} nm"


_CHECKS: tuple[tuple[str, Check, str, tuple[str, ...]], ...] = (
    ("losses", _losses, "none while it is driven", ("rest",)),
    ("rate of samples", _rate, f"{100 * RATE_SHARE:.0f} % of the declared rate", ("approach",)),
    ("age of samples", _age, f"the declared latency and {1e3 * AGE_S:.0f} ms at most, in the median", ("rest",)),
    ("gaps", _gaps, f"no silence of more than {1e3 * GAP_S:.0f} ms and the declared latency", ("rest",)),
    ("range of the input", _in_range, "never saturated", ("rest",)),
    ("noise at rest", _noise, f"{100 * NOISE_SHARE:.0f} % of the force that counts as contact, at most", ("rest",)),
    ("drift at rest", _drift, f"{100 * NOISE_SHARE:.0f} % of the force that counts as contact, at most", ("rest",)),
    ("zero at rest", _zero, "no more than the force that counts as contact", ("rest",)),
    (
        "range of the base",
        _range,
        f"what was sent within {100 * RANGE_SHARE:.0f} % and {1e9 * RANGE_M:.0f} nm",
        ("range",),
    ),
    ("surface", _surface, "found within the limits of the guard", ("approach",)),
    ("sign of the force", _sign, "the sample pushes harder when the base goes towards it", ("contact",)),
    (
        "scale of the force",
        _scale,
        f"{100 * SCALE_LEAST:.0f} to {100 * SCALE_MOST:.0f} % of the cantilever's stiffness",
        ("contact",),
    ),
    (
        "latency",
        _latency,
        f"the declared one, and {100 * LATENCY_SHARE:.0f} % or {1e3 * LATENCY_S:.0f} ms more",
        ("contact",),
    ),
    ("limit of the force", _limit, "never exceeded", ("contact",)),
    ("watchdog", _watchdog, "the tip is retracted by guard or script while this rig is silent", ("silence",)),
    ("coming back", _back, f"within {BACK_S:.0f} s, retracted", ("back",)),
)


def _facts_of(limits: Any, **facts: Any) -> Facts:
    return Facts(limits=SafetyParams(**limits), **facts)


INSTRUMENT = Kind(ROW, _facts_of, _CHECKS, say_what_is_missing=True)
