"""Contact point, modulus and adhesion of a force curve, each with a standard error that allows for correlated noise.

    curve = MeasuredWays(height_m, force_n, height_m, force_n, stiffness_n_per_m)
    found = fit_curve(curve, ContactShape("hertz", radius_m=30e-9))
    found.modulus_pa, found.modulus_error_pa, found.refused

Hertz and Sneddon are fitted to the whole approach. DMT and JKR are fitted to the retraction from the load to shortly
before the pull-off, and to its free end away from the sample. The free parameters are the contact point, the modulus,
the pull-off (DMT and JKR only), the zero line of the force and its tilt. At each place of the base the model is in
equilibrium with the spring (`contact_models`), so noise of the deflection enters the force alone. A fit against the
measured indentation, which contains the same noise, would be biased for a soft lever. The noise is white noise plus a
correlated part, estimated from the residuals (`correlated_noise`).

With Hertz and Sneddon the adhesion is the pull at the last jump of the retraction: a line or parabola through the
points before the jump, against the zero line behind it. A retraction that comes off without a jump gives the lowest
point. Where neither is seen the adhesion is 0, and its error is such that the 95 % interval reaches to the least jump
that would have been seen.

A curve whose figures would be worthless is refused; the reason says what was seen and what can be done about it.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis import denied
from telenano.numerics import compiled, compiled_form
from telenano.wire import ConfigError
from telenano_lab.microscopy.contact_models import DMT, HERTZ, JKR, MODELS, SNEDDON, Contact, at, end_of, forces
from telenano_lab.microscopy.correlated_noise import RATIOS, Noise, correlated_noise

Array = npt.NDArray[np.float64]

# Neighbouring points of a branch are averaged until at most this number of points is left.
_MOST_POINTS = 256
# A fit needs at least this number of points in contact, and as many away from the sample.
_LEAST_POINTS = 10
# A branch is taken up to this multiple of the points in contact.
_FREE_TIMES = 10
# Until the contact is known, this share of a branch, at its end away from the sample, counts as free of force.
_FREE_SHARE = 0.25
# This share of the contact before the pull-off is left out: it may end a little earlier or later than in the model.
_LEFT_OUT = 0.03
# Points within this share of the contact from the end that the model predicts are left out as well.
_NEXT_TO_END = {DMT: 0.02, JKR: 0.1}
# Number of points before and behind the last jump of a retraction from which its pull is found.
_BEFORE_JUMP, _BEHIND_JUMP = 24, 120
# A load, a pull or a jump counts as seen where it exceeds its noise by this factor.
_SEEN = 6.0
# A load or a pull is beyond the zero line, which is continued to its place, by this multiple of the error of that line.
_ZERO_ERRORS = 3.0
# A fit is refused where the modulus changes over the depth by more than this share and by more than so many errors.
_LEAST_CHANGE, _CHANGE_ERRORS = 0.1, 4.0
# A smaller change of more than so many errors is added to the errors of contact point and modulus.
_DOUBT_ERRORS = 2.0
# The detector is saturated where more than this share of the points has the greatest force.
_FLAT_SHARE = 0.05
_NOISE_STEPS = 6
# Averaging over neighbours reduces the white noise and leaves the correlated noise, so greater ratios are possible.
_OF_AVERAGES = (*RATIOS, 300.0, 1000.0)
# Number of contact points along the branch that are tried as the start of a fit.
_STARTS = 80


class ContactShape(NamedTuple):
    """The assumed contact of tip and sample.

    model: hertz, sneddon, dmt or jkr. radius_m: radius of the tip [m], for all models but sneddon. half_angle_rad: half
    angle of the cone [rad], for sneddon. poisson: Poisson ratio of the sample. thickness_m: thickness of a sample on a
    hard ground [m], 0 for a thick one; only with hertz and dmt, and a Poisson ratio of 0.5.
    """

    model: str
    radius_m: float = 0.0
    half_angle_rad: float = 0.0
    poisson: float = 0.5
    thickness_m: float = 0.0

    def checked(self) -> "ContactShape":
        """Return the shape itself; ConfigError names a value that is missing, out of range or unfit for the model."""
        if self.model not in MODELS:
            raise ConfigError(f"model: is {self.model!r}; it must be one of {', '.join(MODELS)}")
        if self.model == "sneddon":
            if not 0.0 < self.half_angle_rad < 0.5 * math.pi:
                raise ConfigError("half_angle_rad: a cone has one between 0 and pi/2 (--half-angle, in degrees)")
        elif not 0.0 < self.radius_m <= 1e-3:
            raise ConfigError(f"radius_m: the model {self.model} needs one above 0 and at most 1 mm (--radius, in nm)")
        if not 0.0 <= self.poisson <= 0.5:
            raise ConfigError(f"poisson: is {self.poisson:g}; it must be between 0 and 0.5")
        if self.thickness_m:
            if not 0.0 < self.thickness_m <= 1.0:
                raise ConfigError(f"thickness_m: is {self.thickness_m:g} m; it must be above 0 and at most 1 m")
            if self.model not in ("hertz", "dmt"):
                raise ConfigError(f"thickness_m: has no equation with the model {self.model}: take hertz or dmt")
            if self.poisson != 0.5:
                raise ConfigError("thickness_m: its equation is that of a Poisson ratio of 0.5: set it to that")
        return self

    @property
    def reduced(self) -> float:
        """Return the ratio of the reduced modulus to the modulus, 1/(1 - nu^2)."""
        return 1.0 / (1.0 - self.poisson * self.poisson)


class MeasuredWays(NamedTuple):
    """Approach and retraction: height of the base [m], ascending away from the sample, and force on the tip [N].

    retract_m and retract_n are empty if there is no retraction.
    """

    approach_m: Array
    approach_n: Array
    retract_m: Array
    retract_n: Array
    stiffness_n_per_m: float


class FitPicture(NamedTuple):
    """Data for a picture of a fit: place of the base towards the sample [m], measured and fitted force [N]."""

    base_m: Array
    measured_n: Array
    model_n: Array


class CurveFit(NamedTuple):
    """Results of a fit with standard errors, NaN where there are none; `refused` is the reason of a refusal, or empty.

    contact_m: height of the base at which the undeflected tip touches the surface. modulus_pa: Young's modulus.
    adhesion_n: greatest pull. residual_n: root mean square of the residuals. wander_n: standard deviation of the
    correlated noise. indentation_m: greatest indentation. load_n: greatest force. modulus_change, modulus_change_error:
    share by which the modulus changes from depth zero to the greatest depth.
    """

    contact_m: float = math.nan
    contact_error_m: float = math.nan
    modulus_pa: float = math.nan
    modulus_error_pa: float = math.nan
    adhesion_n: float = math.nan
    adhesion_error_n: float = math.nan
    residual_n: float = math.nan
    wander_n: float = math.nan
    indentation_m: float = math.nan
    load_n: float = math.nan
    modulus_change: float = math.nan
    modulus_change_error: float = math.nan
    points: int = 0
    refused: str = ""
    shown: FitPicture | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name, without the reason of a refusal and the data for the picture."""
        return {name: value for name, value in self._asdict().items() if name not in ("refused", "shown")}


class _Way(NamedTuple):
    """One branch of a curve, approach or retraction, in the order of time, averaged over `over` raw points each.

    base_m: position of the base towards the sample [m]; force_n: force [N]; place: index in the raw branch.
    """

    base_m: Array
    force_n: Array
    place: Array
    over: int


class _RefusedError(Exception):
    """A curve whose figures would be worthless; the message is the reason."""


def fit_curve(curve: MeasuredWays, shape: ContactShape) -> CurveFit:
    """Fit a contact to a curve; if it cannot be fitted, return a `CurveFit` with the reason in `refused`.

    Raises:
        ConfigError: The shape is invalid, or the spring constant is not a positive finite number.
    """
    shape.checked()
    if not 0.0 < curve.stiffness_n_per_m < math.inf:
        raise ConfigError(f"stiffness_n_per_m: is {curve.stiffness_n_per_m:g}; it must be above 0")
    try:
        return _fitted(curve, shape)
    except _RefusedError as error:
        return CurveFit(refused=str(error))
    except np.linalg.LinAlgError:
        return CurveFit(refused="the points do not tell contact point, modulus and zero line apart")


def _fitted(curve: MeasuredWays, shape: ContactShape) -> CurveFit:
    number = MODELS[shape.model]
    approach_m, approach_n = _near(curve.approach_m, curve.approach_n)
    approach = _way(approach_m[::-1], approach_n[::-1], "approach")
    retract = _way(*_near(curve.retract_m, curve.retract_n), "retraction") if len(curve.retract_m) else None
    most = int(np.argmax(approach.force_n))
    free_end = slice(0, max(int(_FREE_SHARE * len(approach.base_m)), _LEAST_POINTS))
    zero_n, error_n, noise_n = _zero_line(approach, free_end, float(approach.base_m[most]))
    load_n = float(approach.force_n[most]) - zero_n
    if not load_n > max(_SEEN * noise_n, _ZERO_ERRORS * error_n):
        raise _RefusedError(
            f"it does not touch: it presses with {1e9 * load_n:.2g} nN, and its noise is {1e9 * noise_n:.2g} nN"
        )
    _refuse_flat(curve.approach_n, noise_n)
    if number in (HERTZ, SNEDDON):
        way, contact, pull = approach, np.ones(len(approach.base_m), bool), None
    else:
        if retract is None:
            raise _RefusedError(f"it has no retraction, to which {shape.model} is fitted: take hertz or sneddon")
        way, contact, pull = _pulling(retract, shape.model)
    start = _start(number, shape, curve.stiffness_n_per_m, way, contact, pull)
    problem = _Problem(
        number, shape.radius_m, math.tan(shape.half_angle_rad) if number == SNEDDON else 0.0,
        curve.stiffness_n_per_m, 1.0 / shape.thickness_m if shape.thickness_m else 0.0,
        float(np.ptp(way.base_m)), max(float(np.ptp(way.force_n)), 1e-15),
    )  # fmt: skip
    free = _least_squares(problem, start, way, contact)
    if pull is not None:
        way, contact = _well_on_branch(problem, free, way, contact)
        free = _least_squares(problem, free, way, contact)
    free, noise, jacobian, model_n, depth_m = _in_noise(problem, free, way, contact)
    errors = [math.sqrt(float(each)) for each in np.diagonal(noise.covariance)]
    left = way.force_n - model_n
    scale = problem.force_scale_n
    if pull is not None:
        _add_early_end(problem, free, pull, errors, float(depth_m.max()))
    touch_m, modulus = float(free[0]) * problem.length_scale_m, math.exp(float(free[1])) / shape.reduced
    indented_m = float(depth_m.max())
    touched = int(np.count_nonzero(depth_m > 0.0))
    found = CurveFit(
        contact_m=-touch_m,
        contact_error_m=errors[0] * problem.length_scale_m,
        modulus_pa=modulus,
        modulus_error_pa=modulus * errors[1],
        residual_n=math.sqrt(math.fsum((left * left).tolist()) / len(left)),
        wander_n=noise.wander * scale,
        indentation_m=indented_m,
        load_n=load_n,
        points=len(way.base_m),
        shown=FitPicture(way.base_m, way.force_n, model_n),
    )
    if reason := denied("the contact", 1.0, 0.0, points=(touched, _LEAST_POINTS)):
        raise _RefusedError(f"{reason}: press deeper")
    if number in (HERTZ, SNEDDON) and len(way.base_m) - touched < _LEAST_POINTS:
        raise _RefusedError("it begins in contact: a zero line is needed, so begin further away")
    if reason := denied("the modulus", modulus, modulus * errors[1], "Pa"):
        raise _RefusedError(f"{reason}: the sample is too hard for this lever, or the load too small")
    if number in (HERTZ, SNEDDON):
        _refuse_dip(way, model_n, depth_m, noise_n, load_n)
    change = _change_over_depth(problem, way, depth_m, jacobian, left)
    found = found._replace(modulus_change=change.share, modulus_change_error=change.error)
    if abs(change.share) > max(_LEAST_CHANGE, _CHANGE_ERRORS * change.error):
        more = "a thin layer on a hard ground (--thickness), a yielding sample or another shape of the tip"
        raise _RefusedError(
            f"the modulus changes over the depth by {100.0 * change.share:.0f} ± {100.0 * change.error:.0f} %: the"
            f" model {shape.model} does not describe it; {more} may"
        )
    if abs(change.share) > _DOUBT_ERRORS * change.error:
        # A fit without the change is as likely, so its shift of each figure is added to the errors.
        errors = [math.sqrt(error**2 + moved**2) for error, moved in zip(errors, change.moved, strict=True)]
        if reason := denied("the modulus", modulus, modulus * errors[1], "Pa"):
            raise _RefusedError(
                f"{reason}: it changes over the depth by {100.0 * change.share:.0f} ± {100.0 * change.error:.0f} %, so"
                f" that the model {shape.model} may not describe it"
            )
        found = found._replace(contact_error_m=errors[0] * problem.length_scale_m, modulus_error_pa=modulus * errors[1])
    if number in (DMT, JKR):
        pull_n = float(free[2]) * scale if number == DMT else math.exp(float(free[2])) * scale
        return found._replace(adhesion_n=pull_n, adhesion_error_n=errors[2] * (scale if number == DMT else pull_n))
    if retract is None:
        return found
    # The curve has one baseline: the tilt that the approach tells is that of its retraction.
    per_m = scale / problem.length_scale_m
    pull_n, error_n = _pull_at_jump(curve, float(free[4]) * per_m, errors[3] * per_m)
    return found._replace(adhesion_n=pull_n, adhesion_error_n=error_n)


def _near(height_m: Array, force_n: Array) -> tuple[Array, Array]:
    """Return a branch without most of a far end that is ten times as long as the contact; height_m rises from it.

    Averages over neighbours would otherwise leave few points of a contact that is a hundredth of the way.
    """
    sound = np.isfinite(height_m) & np.isfinite(force_n)
    height, force = height_m[sound], force_n[sound]
    count = len(height)
    if count <= _MOST_POINTS:
        return height, force
    far = slice(count - int(_FREE_SHARE * count), count)
    zero, slope, noise = _line(height[far], force[far])
    middle = math.fsum(height[far].tolist()) / (far.stop - far.start)
    touching = np.flatnonzero(np.abs(force - zero - slope * (height - middle)) > _SEEN * noise)
    kept = max(_FREE_TIMES * (int(touching[-1]) + 1 if len(touching) else count), _MOST_POINTS)
    return height[:kept], force[:kept]


def _way(height_m: Array, force_n: Array, name: str) -> _Way:
    """Return a branch in the order of time, averaged over neighbours; height_m rises away from the sample."""
    sound = np.isfinite(height_m) & np.isfinite(force_n)
    base, force = -height_m[sound], force_n[sound]
    if len(base) < 4 * _LEAST_POINTS:
        raise _RefusedError(f"its {name} has {len(base)} valid points; {4 * _LEAST_POINTS} are needed")
    over = -(-len(base) // _MOST_POINTS)
    count = len(base) // over
    # Surplus points that do not fill an average are dropped at the end away from the sample, where points abound.
    cut = slice(len(base) - count * over, None) if base[0] < base[-1] else slice(0, count * over)
    means = []
    for values in (base[cut], force[cut]):
        rows = values.reshape(count, over)
        total = np.zeros(count)
        for place in range(over):
            total = total + rows[:, place]
        means.append(total / over)
    return _Way(means[0], means[1], np.arange(count, dtype=np.float64), over)


def _line(x: Array, y: Array) -> tuple[float, float, float]:
    """Return the mean of y, at the mean of x, the slope of the regression line, and the standard deviation about it."""
    n = len(x)
    mean_x, mean_y = math.fsum(x.tolist()) / n, math.fsum(y.tolist()) / n
    dx, dy = x - mean_x, y - mean_y
    square = math.fsum((dx * dx).tolist())
    slope = math.fsum((dx * dy).tolist()) / square if square > 0.0 else 0.0
    left = dy - slope * dx
    return mean_y, slope, math.sqrt(math.fsum((left * left).tolist()) / max(n - 2, 1))


def _zero_line(way: _Way, part: slice, at_m: float) -> tuple[float, float, float]:
    """Return the zero of the force at a place of the base, its error, and the noise [N], by the line of a free part."""
    base = way.base_m[part]
    mean, slope, noise = _line(base, way.force_n[part])
    middle = math.fsum(base.tolist()) / len(base)
    away, spread = at_m - middle, math.fsum(((base - middle) ** 2).tolist())
    error = noise * math.sqrt(1.0 / len(base) + (away * away / spread if spread > 0.0 else 0.0))
    return mean + slope * away, error, noise


def _behind(pull: int, count: int) -> int:
    """Return from which point on a retraction is free: near its jump the lever may ring, or the tip be attracted."""
    return pull + 1 + max(round(0.2 * (count - pull)), 1)


def _free_end(pull: int, count: int) -> slice:
    """Return the end of a retraction whose line is its zero: a quarter, and no point in front of or near its jump."""
    return slice(min(max(count - int(_FREE_SHARE * count), _behind(pull, count)), count - _LEAST_POINTS), count)


def _refuse_flat(force_n: Array, noise_n: float) -> None:
    """Refuse a curve of which too many points share the greatest force, as with a saturated detector."""
    sound = force_n[np.isfinite(force_n)]
    top = int(np.count_nonzero(sound == sound.max()))
    # A converter of few bits repeats every value often, not only the greatest.
    _, counts = np.unique(sound, return_counts=True)
    usual = float(np.median(counts))
    if top > max(_FLAT_SHARE * len(sound), 4.0 * usual, 5.0):
        raise _RefusedError(f"{top} of its {len(sound)} points are at the greatest force: the detector is at its end")


def _refuse_dip(way: _Way, model_n: Array, depth_m: Array, noise_n: float, load_n: float) -> None:
    """Refuse an approach with an attraction before contact, which Hertz and Sneddon do not describe."""
    left = way.force_n - model_n
    width = 5
    sums = np.zeros(len(left) - width + 1)
    for place in range(width):
        sums = sums + left[place : len(left) - width + 1 + place]
    means = sums / width
    touch = int(np.argmax(depth_m > 0.0))
    near = means[max(touch - len(left) // 5, 0) : touch + len(left) // 20 + 1]
    far = means[: max(touch - len(left) // 5, width)]
    usual = max(noise_n / math.sqrt(width), float(np.abs(far).max()) / 3.0 if len(far) else 0.0)
    if len(near) and float(near.min()) < -max(_SEEN * usual, 0.02 * load_n):
        raise _RefusedError(
            f"the approach is pulled in with {-1e9 * float(near.min()):.2g} nN before it touches, which this model does"
            " not have: take dmt or jkr"
        )


class _Pull(NamedTuple):
    """The end of the contact on a retraction: mean place of the base [m] and mean force [N] of its last points."""

    base_m: float
    force_n: float


def _pulling(way: _Way, model: str) -> tuple[_Way, npt.NDArray[np.bool_], _Pull]:
    """Return the contact up to shortly before the pull-off plus the free end, a mask of the contact, the pull-off."""
    pull, count = _last_in_contact(way), len(way.base_m)
    last, first = max(round((1.0 - _LEFT_OUT) * pull), 0), _behind(pull, count)
    if last < _LEAST_POINTS or count - first < _LEAST_POINTS:
        raise _RefusedError(
            f"its retraction has {last} points in contact before the pull-off and {max(count - first, 0)} far from the"
            f" sample; {_LEAST_POINTS} of each are needed"
        )
    zero_n, error_n, noise_n = _zero_line(way, _free_end(pull, count), float(way.base_m[pull]))
    depth = zero_n - math.fsum(way.force_n[max(pull - 2, 0) : pull + 1].tolist()) / min(3, pull + 1)
    if not depth > max(_SEEN * noise_n / math.sqrt(3.0), _ZERO_ERRORS * error_n):
        raise _RefusedError(f"its retraction has no pull-off, which {model} needs: take hertz or sneddon")
    kept = np.r_[0 : last + 1, first:count]
    end = _Pull(*(math.fsum(each[pull - 2 : pull + 1].tolist()) / 3.0 for each in (way.base_m, way.force_n)))
    return _Way(way.base_m[kept], way.force_n[kept], way.place[kept], way.over), kept <= last, end


def _last_in_contact(way: _Way) -> int:
    """Return the index of the last point before the greatest rise of the force between two groups of points."""
    force, width = way.force_n, 4
    count = len(force)
    before, behind = np.zeros(count - 2 * width + 1), np.zeros(count - 2 * width + 1)
    for place in range(width):
        before = before + force[place : count - 2 * width + 1 + place]
        behind = behind + force[width + place : count - width + 1 + place]
    # The index is the last of the group before the rise.
    return int(np.argmax(behind - before)) + width - 1


def _lowest(force: Array, width: int) -> int:
    """Return the index of the middle point of the group of `width` points that has the lowest mean."""
    sums = np.zeros(len(force) - width + 1)
    for place in range(width):
        sums = sums + force[place : len(force) - width + 1 + place]
    return int(np.argmin(sums)) + width // 2


def _smooth_pull(way: _Way, lowest: int, last: int, noise_n: float) -> tuple[float, float] | None:
    """Return the greatest pull [N] and its error for a retraction that comes off without a jump; None where it jumps.

    A stiff lever follows the contact past its greatest pull, so a parabola is fitted to the points on both sides of it.
    """
    force, count = way.force_n, len(way.force_n)
    half = min(_BEFORE_JUMP // 2, max(count // 60, 5))
    inside = np.arange(max(lowest - half, 0), min(lowest + half + 1, count))
    behind = np.arange(max(count - _BEHIND_JUMP, count - int(_FREE_SHARE * count), lowest + 2 * half), count)
    if len(inside) < 2 * half or len(behind) < 2 * _LEAST_POINTS:
        return None
    width = 4
    deep = math.fsum(force[lowest - width // 2 : lowest + width // 2].tolist()) / width
    before = math.fsum(force[max(last + 1 - width, 0) : last + 1].tolist()) / min(width, last + 1)
    zero = math.fsum(force[behind].tolist()) / len(behind)
    # Without a jump, the force has risen again before its greatest step, so the greatest pull is no end of a branch.
    if not (lowest < last and before - deep > _SEEN * noise_n and zero - deep > 2.0 * _SEEN * noise_n):
        return None
    chosen = np.concatenate([inside, behind])
    is_inside = (chosen <= inside[-1]).astype(np.float64)
    x = (chosen - lowest) / half
    columns = np.stack([np.ones(len(chosen)), is_inside, is_inside * x, is_inside * x * x], axis=1)
    scale = max(float(np.ptp(force[chosen])), 1e-15)
    noise = correlated_noise(force[chosen] / scale, columns, way.place[chosen])
    _, level, slope, bow = noise.coefficients.tolist()
    deepest = slope * slope / (4.0 * bow) if bow > 0.0 and abs(slope) < 2.0 * bow else 0.0
    return -scale * (level - deepest), scale * math.sqrt(float(noise.covariance[1, 1]))


def _pull_at_jump(curve: MeasuredWays, tilt_n_per_m: float, tilt_error_n_per_m: float) -> tuple[float, float]:
    """Return the pull of a retraction at its last jump [N] and its standard error; the pull is 0 where no jump is seen.

    The tilt of the force over the base [N/m] is taken off first: a line that falls from the far end to the contact
    would be a pull, and one that rises would hide a pull. Its standard error counts over the way to the zero line.

    Only points near the jump are used, and unaveraged, because an average over neighbours would mix both sides of it.
    """
    sound = np.isfinite(curve.retract_m) & np.isfinite(curve.retract_n)
    base, force = -curve.retract_m[sound], curve.retract_n[sound]
    force = force - tilt_n_per_m * (base - base[-1])
    way = _Way(base, force, np.arange(len(base), dtype=np.float64), 1)
    last, count, width = _last_in_contact(way), len(force), 4
    before = np.arange(max(last - min(_BEFORE_JUMP, max(count // 30, 10)) + 1, 0), last + 1)
    behind = np.arange(last + 1, min(last + 1 + _BEHIND_JUMP, count))
    noise_n = _zero_line(way, _free_end(last, count), float(base[last]))[2]
    least_n = _SEEN * noise_n * math.sqrt(0.5)
    lowest = _lowest(force, width)
    doubt_n = tilt_error_n_per_m * abs(float(base[lowest] - base[-1]))
    if (smooth := _smooth_pull(way, lowest, last, math.hypot(noise_n, doubt_n))) is not None:
        return smooth[0], math.hypot(smooth[1], doubt_n)
    ends = force[last + 1 - width : last + 1].tolist(), force[last + 1 : last + 1 + width].tolist()
    jump = (math.fsum(ends[1]) - math.fsum(ends[0])) / width
    if not jump > least_n or len(before) < 8 or len(behind) < 8:
        return 0.0, least_n / 1.96
    chosen = np.concatenate([before, behind])
    is_before = (chosen <= last).astype(np.float64)
    # The jump lies at an unknown place between two points.
    edge = 0.5 * float(base[last] + base[last + 1])
    x = (base[chosen] - edge) / max(abs(float(base[before[0]]) - edge), 1e-15)
    columns = np.stack([np.ones(len(chosen)), x, is_before, is_before * x, is_before * x * x], axis=1)
    scale = max(float(np.ptp(force[chosen])), 1e-15)
    noise = correlated_noise(force[chosen] / scale, columns, way.place[chosen])
    slope = abs(float(noise.coefficients[3])) / len(before)
    error = math.sqrt(float(noise.covariance[2, 2]) + slope * slope / 12.0)
    return -scale * float(noise.coefficients[2]), scale * error


class _Problem(NamedTuple):
    model: int
    radius_m: float
    tangent: float
    stiffness_n_per_m: float
    per_thickness_per_m: float
    length_scale_m: float
    force_scale_n: float


def _start(
    number: int, shape: ContactShape, k: float, way: _Way, contact: npt.NDArray[np.bool_], pull: _Pull | None
) -> Array:
    """Return the starting values of a fit, in the problem's units: touch, logarithm of E*, pull-off, zero, tilt."""
    length, scale = float(np.ptp(way.base_m)), max(float(np.ptp(way.force_n)), 1e-15)
    if pull is None:
        return _start_of_push(number, shape, k, way, length, scale)
    free = ~contact
    zero, slope, _ = _line(way.base_m[free], way.force_n[free])
    middle = math.fsum(way.base_m[free].tolist()) / int(np.count_nonzero(free))
    base, force = way.base_m[contact], way.force_n[contact]
    force = force - zero - slope * (base - middle)
    count = 3
    top_n, top_m = (math.fsum(each[:count].tolist()) / count for each in (force, base))
    low_n, low_m = pull.force_n - zero - slope * (pull.base_m - middle), pull.base_m
    pull_n = max(-low_n, 1e-3 * scale)
    indented_m = max((top_m - low_m) - (top_n - low_n) / k, 1e-3 * length)
    ratio = (top_n + pull_n) / indented_m**1.5
    modulus = 0.75 * ratio / math.sqrt(shape.radius_m)
    if number == JKR:
        modulus, touch_m = _start_of_jkr(shape.radius_m, k, pull_n, (top_m, top_n), low_m)
        return np.array([touch_m / length, math.log(modulus), math.log(pull_n / scale), zero / scale,
                         slope * length / scale])  # fmt: skip
    touch_m = low_m + pull_n / k
    return np.array([touch_m / length, math.log(modulus), pull_n / scale, zero / scale, slope * length / scale])


def _start_of_jkr(
    radius_m: float, k: float, pull_n: float, top: tuple[float, float], low_m: float
) -> tuple[float, float]:
    """Return E* [Pa] and touch [m] for which the model moves as far from pull-off, at low_m, to top as measured."""
    top_m, top_n = top

    def bases(modulus: float) -> tuple[float, float]:
        stiffness = 4.0 * modulus / (3.0 * radius_m)
        contact = Contact(JKR, radius_m, 0.0, k, modulus, pull_n, 0.0)
        ends = []
        for force in (top_n, -pull_n):
            root = math.sqrt(max(stiffness * pull_n + stiffness * force, 0.0))
            cube = (math.sqrt(stiffness * pull_n) + root) / stiffness
            depth, found, _, _ = at(contact, cube ** (1.0 / 3.0))
            ends.append(depth + found / k)
        return ends[0], ends[1]

    low, high = 1e-3, 1e14
    for _ in range(100):
        middle = math.sqrt(low * high)
        deepest, least = bases(middle)
        low, high = (middle, high) if deepest - least > top_m - low_m else (low, middle)
    modulus = math.sqrt(low * high)
    return modulus, top_m - bases(modulus)[0]


def _start_of_push(number: int, shape: ContactShape, k: float, way: _Way, length: float, scale: float) -> Array:
    best = (math.inf, 0.0, 0.0, 0.0)
    count = len(way.base_m)
    for place in np.unique(np.linspace(_LEAST_POINTS, count - 4, _STARTS).astype(int)).tolist():
        zero, slope, _ = _line(way.base_m[:place], way.force_n[:place]) if place > count // 3 else (
            math.fsum(way.force_n[:place].tolist()) / place, 0.0, 0.0)  # fmt: skip
        middle = math.fsum(way.base_m[:place].tolist()) / place
        touch = float(way.base_m[place])
        force = way.force_n - zero - slope * (way.base_m - middle)
        depth = np.clip(way.base_m - touch - force / k, 0.0, None)
        depth[:place] = 0.0
        form = depth * np.sqrt(depth) if number == HERTZ else depth * depth
        square = math.fsum((form * form).tolist())
        factor = math.fsum((form * force).tolist()) / square if square > 0.0 else 0.0
        left = force - factor * form
        rest = math.fsum((left * left).tolist())
        if factor > 0.0 and rest < best[0]:
            best = (rest, touch, factor, zero)
    if not math.isfinite(best[0]):
        raise _RefusedError("its force rises nowhere as that of a contact: is its sign turned (--set value_sign=-1)?")
    per = 4.0 / 3.0 * math.sqrt(shape.radius_m) if number == HERTZ else 2.0 / math.pi * math.tan(shape.half_angle_rad)
    return np.array([best[1] / length, math.log(best[2] / per), 0.0, best[3] / scale, 0.0])


@compiled
def _contact(problem: _Problem, free: Array) -> Contact:
    scale = problem.force_scale_n
    pull = math.exp(free[2]) * scale if problem.model == JKR else free[2] * scale
    return Contact(
        problem.model, problem.radius_m, problem.tangent, problem.stiffness_n_per_m, math.exp(free[1]), pull,
        problem.per_thickness_per_m,
    )  # fmt: skip


@compiled
def _predict(
    problem: _Problem, free: Array, base_m: Array, touching: npt.NDArray[np.bool_], out: Array, depth_m: Array
) -> None:
    """Fill out with the forces, in units of the problem's force scale, and depth_m with the indentations [m]."""
    scale = problem.force_scale_n
    contact = _contact(problem, free)
    forces(contact, free[0] * problem.length_scale_m, base_m, out, depth_m)
    middle = 0.5 * (base_m[0] + base_m[base_m.shape[0] - 1])
    for i in range(base_m.shape[0]):
        if not touching[i]:
            out[i], depth_m[i] = 0.0, 0.0
        out[i] = out[i] / scale + free[3] + free[4] * (base_m[i] - middle) / problem.length_scale_m


@compiled
def _slopes(
    problem: _Problem, free: Array, base_m: Array, touching: npt.NDArray[np.bool_], which: Array, jacobian: Array
) -> None:
    """Fill jacobian, shape (n, p), with the derivatives of the forces by each free parameter (central differences)."""
    count = base_m.shape[0]
    ahead, behind, depth = np.empty(count), np.empty(count), np.empty(count)
    moved = free.copy()
    for column in range(which.shape[0]):
        one = int(which[column])
        # The touch is a share of the whole branch.
        step = 1e-6 if one == 0 else 1e-5
        moved[one] = free[one] + step
        _predict(problem, moved, base_m, touching, ahead, depth)
        moved[one] = free[one] - step
        _predict(problem, moved, base_m, touching, behind, depth)
        moved[one] = free[one]
        for i in range(count):
            jacobian[i, column] = (ahead[i] - behind[i]) / (2.0 * step)


@compiled
def _is_of_a_sample(free: Array) -> bool:
    """Return whether the logarithm of the modulus and the pull-off lie in a range that a sample can have."""
    return bool(-10.0 < free[1] < 35.0 and abs(free[2]) < 50.0)


@compiled
def _descend(
    problem: _Problem, free: Array, base_m: Array, force: Array, touching: npt.NDArray[np.bool_], which: Array
) -> bool:
    """Move free to the least-squares minimum by Levenberg-Marquardt steps; return whether they converged."""
    count, width = base_m.shape[0], which.shape[0]
    model, depth, jacobian = np.empty(count), np.empty(count), np.empty((count, width))
    normal, factor, step = np.empty((width, width)), np.empty((width, width)), np.empty(width)
    slope = np.empty(width)
    _predict(problem, free, base_m, touching, model, depth)
    cost = 0.0
    for i in range(count):
        cost += (force[i] - model[i]) ** 2
    damping = 1e-3
    for _ in range(200):
        _slopes(problem, free, base_m, touching, which, jacobian)
        for row in range(width):
            slope[row] = 0.0
            for i in range(count):
                slope[row] += jacobian[i, row] * (force[i] - model[i])
            for column in range(row + 1):
                total = 0.0
                for i in range(count):
                    total += jacobian[i, row] * jacobian[i, column]
                normal[row, column] = total
        better = False
        while damping < 1e12:
            positive = True
            for row in range(width):
                for column in range(row + 1):
                    rest = normal[row, column]
                    if row == column:
                        rest = rest * (1.0 + damping) + 1e-300
                    for i in range(column):
                        rest -= factor[row, i] * factor[column, i]
                    if row == column:
                        if not rest > 0.0:
                            positive = False
                            rest = 1.0
                        factor[row, row] = math.sqrt(rest)
                    else:
                        factor[row, column] = rest / factor[column, column]
            for row in range(width):
                rest = slope[row]
                for i in range(row):
                    rest -= factor[row, i] * step[i]
                step[row] = rest / factor[row, row]
            for row in range(width - 1, -1, -1):
                rest = step[row]
                for i in range(row + 1, width):
                    rest -= factor[i, row] * step[i]
                step[row] = rest / factor[row, row]
            moved = free.copy()
            allowed = positive
            for row in range(width):
                one = int(which[row])
                # A step is limited: a logarithm to a factor of e, the touch to a fifth of the branch.
                most = 0.2 if one == 0 else 1.0
                moved[one] += min(max(step[row], -most), most)
            allowed = allowed and _is_of_a_sample(moved)
            if allowed:
                _predict(problem, moved, base_m, touching, model, depth)
                new = 0.0
                for i in range(count):
                    new += (force[i] - model[i]) ** 2
                if new <= cost:
                    better = True
                    break
            damping *= 4.0
        if not better:
            _predict(problem, free, base_m, touching, model, depth)
            return True
        ended = cost - new <= 1e-12 * cost
        for row in range(free.shape[0]):
            free[row] = moved[row]
        cost = new
        damping = max(damping / 9.0, 1e-9)
        if ended:
            return True
    return False


def _add_early_end(problem: _Problem, free: Array, pull: _Pull, errors: list[float], indented_m: float) -> None:
    """Add to the errors the least error that follows where the fitted contact ends before the measured one."""
    early_m = max(_end_of(problem, free) - pull.base_m, 0.0)
    pull_n = problem.stiffness_n_per_m * early_m / problem.force_scale_n
    shares = (
        early_m / problem.length_scale_m,
        early_m / max(indented_m, early_m),
        pull_n if problem.model == DMT else pull_n / math.exp(float(free[2])),
    )
    for place, share in enumerate(shares):
        errors[place] = math.sqrt(errors[place] ** 2 + share * share)


def _well_on_branch(
    problem: _Problem, free: Array, way: _Way, contact: npt.NDArray[np.bool_]
) -> tuple[_Way, npt.NDArray[np.bool_]]:
    """Return a retraction without the points of its contact that are next to the end of the contact in the model.

    There the derivative of the force by the place of the end is unbounded, or the points determine the end alone.
    """
    end_m = _end_of(problem, free)
    top_m = float(way.base_m[0])
    kept = ~contact | (way.base_m > end_m + _NEXT_TO_END[problem.model] * (top_m - end_m))
    if int(np.count_nonzero(kept & contact)) < _LEAST_POINTS:
        raise _RefusedError("the fit does not converge: this model does not describe the curve")
    return _Way(way.base_m[kept], way.force_n[kept], way.place[kept], way.over), contact[kept]


def _end_of(problem: _Problem, free: Array) -> float:
    """Return the place of the base at which the fitted contact ends on retraction [m]."""
    contact = compiled_form(_contact)(problem, free)
    depth, force, _, _ = at(contact, compiled_form(end_of)(contact))
    return float(free[0]) * problem.length_scale_m + depth + force / problem.stiffness_n_per_m


def _which(number: int) -> Array:
    return np.array([0, 1, 3, 4] if number in (HERTZ, SNEDDON) else [0, 1, 2, 3, 4], dtype=np.float64)


def _least_squares(problem: _Problem, start: Array, way: _Way, contact: npt.NDArray[np.bool_]) -> Array:
    free = start.copy()
    force = way.force_n / problem.force_scale_n
    if not compiled_form(_descend)(problem, free, way.base_m, force, contact, _which(problem.model)):
        raise _RefusedError("the fit does not converge: this model does not describe the curve")
    return free


def _in_noise(
    problem: _Problem, free: Array, way: _Way, contact: npt.NDArray[np.bool_]
) -> tuple[Array, Noise, Array, Array, Array]:
    """Return free values fitted in the estimated noise, that noise, the Jacobian, fitted forces [N], indentations [m].

    The noise carries the covariance of the parameters that vary.
    """
    which = _which(problem.model)
    places = which.astype(int)
    force = way.force_n / problem.force_scale_n
    count = len(force)
    model, depth, jacobian = np.empty(count), np.empty(count), np.empty((count, len(places)))
    before, share = np.zeros(len(places)), 1.0
    for _ in range(_NOISE_STEPS):
        compiled_form(_predict)(problem, free, way.base_m, contact, model, depth)
        compiled_form(_slopes)(problem, free, way.base_m, contact, which, jacobian)
        noise = correlated_noise(force - model, jacobian, way.place, _OF_AVERAGES)
        errors = np.sqrt(np.diagonal(noise.covariance))
        move = np.clip(noise.coefficients, -3.0 * errors, 3.0 * errors)
        # A step that reverses the one before is halved, and so are all later ones.
        if math.fsum(((move / errors) * (before / errors)).tolist()) < 0.0:
            share *= 0.5
        before = move
        free = free.copy()
        free[places] += share * move
        if not compiled_form(_is_of_a_sample)(free):
            raise _RefusedError("the fit does not converge: this model does not describe the curve")
        if np.all(np.abs(move) <= 0.05 * errors):
            break
    compiled_form(_predict)(problem, free, way.base_m, contact, model, depth)
    return free, noise, jacobian, model * problem.force_scale_n, depth


class _Change(NamedTuple):
    """Share by which the modulus changes over the depth, its standard error, and the shift of each parameter."""

    share: float
    error: float
    moved: list[float]


def _change_over_depth(problem: _Problem, way: _Way, depth_m: Array, jacobian: Array, left_n: Array) -> _Change:
    share = np.clip(depth_m, 0.0, None) / max(float(depth_m.max()), 1e-15)
    columns = np.column_stack([jacobian, jacobian[:, 1] * share])
    noise = correlated_noise(left_n / problem.force_scale_n, columns, way.place, _OF_AVERAGES)
    *moved, change = noise.coefficients.tolist()
    return _Change(change, math.sqrt(float(noise.covariance[-1, -1])), moved)
