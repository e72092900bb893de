"""Smith predictor around the paper's virtual impedance: the force that the delayed loop will have, from a model.

    F = F_s(t - T) + K_e [x_ref(t) - x_ref(t - T)],
    M_v x'' + B_v x' + K_v x = K_f (F_m - alpha_f F) - alpha_f F,   x_sr = alpha_p x

T is the age of the hand's sample that the newest answer responds to, measured by the echo of its number; x_ref is
stored for that time. K_e is the stiffness of the environment at the base of the cantilever. Source: O. J. M. Smith,
"Closer control of loops with dead time", Chemical Engineering Progress 53 (1957).

With K_e = K the correction removes the delay from the loop: on a spring the hand moves, sample by sample, as it would
without a link, and the tip makes the same motion T_f later. Disturbances cannot be predicted: the first contact with a
surface is felt T_b late.

Mismatch. With K_e = K (1 + e) the loop gain is that of the undelayed loop, L_0, times 1 + e (1 - e^(-sT)). That factor
differs from 1 by at most 2 |e|, so the loop is stable at every delay if 2 |e| < min |1 + 1/L_0(jw)|. In free motion
the term would act as a damper of K_e T, so K_e falls to zero, at a limited rate, while the tip is not in contact; after
contact it rises at the same rate, and until then part of the delay remains in the loop. T is measured for each answer,
so varying delay and loss are compensated like constant delay: a lost answer only means that the newest one is older.
The law is not guaranteed to be passive.

K_e is configured, or estimated from the answers: the slope of F_s over x_ref(t - T) in contact, by least squares with
exponential forgetting, frozen while the remembered motion is too small to identify it. If adhesion makes the slope
negative, or the tip jumps, a linear model is wrong; the estimate then stays within its bounds.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from telenano.extend import pass_through
from telenano.extend.laws import HandSample, Law, MasterReference, PortSignal, port_signal
from telenano.extend.ranges import parameter
from telenano.extend.virtual_mass import (
    at_hand,
    periods_in,
)
from telenano.laws import ImpedanceState, VirtualImpedanceParams
from telenano.numerics import compiled, decay
from telenano.sections import VIRTUAL_IMPEDANCE, ImpedanceConfig

# Names of this module, so that numba can compile calls of these steps.
_start = VIRTUAL_IMPEDANCE.master_start
_resume = VIRTUAL_IMPEDANCE.master_resume
_send = VIRTUAL_IMPEDANCE.master_send
_receive = VIRTUAL_IMPEDANCE.master_receive
_retune = VIRTUAL_IMPEDANCE.retune

# Number of stored references, one per period. The oldest one stands in for all earlier ones, so longer delays are
# compensated only in part.
HISTORY = 1024
# Size of the separate block of the newest references; it is short because a step copies the arrays that it changes.
_BLOCK = 32


class SmithParams(NamedTuple):
    """Constants of the law; `forget` is the factor by which the weight of the memory falls in a period."""

    impedance: VirtualImpedanceParams
    stiffness_n_per_m: float
    stiffness_max_n_per_m: float
    rate_n_per_m: float
    estimate: bool
    forget: float
    motion_m: float


class SmithConfig(ImpedanceConfig):
    """Section `controller.smith`: the virtual impedance's parameters, and the model's."""

    environment_stiffness_n_per_m: float = parameter(
        10.0, "N/m", "Stiffness of the environment at the tip K_e, or first estimate of it [N/m]", zero=True
    )
    environment_stiffness_max_n_per_m: float = parameter(60.0, "N/m", "Largest estimate of K_e [N/m]")
    estimate: bool = Field(default=True, description="Whether K_e is estimated from the returned signals")
    memory_s: float = parameter(0.2, "s", "Time constant of forgetting in the estimate [s]")
    least_motion_m: float = parameter(
        5e-11, "m", "Motion of the tip in memory (standard deviation) below which K_e is kept [m]"
    )
    stiffness_rate_n_per_m_s: float = parameter(200.0, "N/(m s)", "Fastest change of the K_e in use [N/(m s)]")

    def to_params(self, period_s: float) -> SmithParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        return SmithParams(
            impedance=self.impedance_params(period_s),
            stiffness_n_per_m=min(self.environment_stiffness_n_per_m, self.environment_stiffness_max_n_per_m),
            stiffness_max_n_per_m=self.environment_stiffness_max_n_per_m,
            rate_n_per_m=self.stiffness_rate_n_per_m_s * period_s,
            estimate=self.estimate,
            forget=decay(period_s / self.memory_s),
            motion_m=self.least_motion_m,
        )


class Estimate(NamedTuple):
    """Exponentially weighted means of x [m] and F [N], variance of x, covariance of x and F, and K_e [N/m]."""

    mean_m: float
    mean_n: float
    square_m2: float
    product_n_m: float
    stiffness_n_per_m: float
    in_contact: bool


class MasterState(NamedTuple):
    """The impedance, the ring of references sent (newest at `newest`), the estimate, and the K_e in use [N/m].

    sent_m: the ring, shape (HISTORY,), in which the newest block is not yet stored; block_m: that block, shape (32,).
    """

    impedance: ImpedanceState
    sent_m: npt.NDArray[np.float64]
    block_m: npt.NDArray[np.float64]
    newest: int
    estimate: Estimate
    in_use_n_per_m: float


@compiled
def _without_memory(stiffness_n_per_m: float) -> Estimate:
    return Estimate(
        mean_m=0.0, mean_n=0.0, square_m2=0.0, product_n_m=0.0, stiffness_n_per_m=stiffness_n_per_m, in_contact=False
    )


@compiled
def _fresh(params: SmithParams, state: ImpedanceState) -> MasterState:
    reference = params.impedance.position_scale * state.position_m + state.tip_offset_m
    sent, estimate = np.full(HISTORY, reference), _without_memory(params.stiffness_n_per_m)
    return MasterState(state, sent, np.full(_BLOCK, reference), 0, estimate, 0.0)


@compiled
def master_start(params: SmithParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position, and that position as the whole history."""
    return _fresh(params, _start(params.impedance, hand))


@compiled
def master_resume(params: SmithParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference."""
    return _fresh(params, _resume(params.impedance, hand, tip_reference_m))


@compiled
def master_send(params: SmithParams, state: MasterState, hand: HandSample, dt: float) -> tuple[MasterState, PortSignal]:
    """Return the slave's reference and store it for every period in dt [s]."""
    inner, signal = _send(params.impedance, state.impedance, hand, dt)
    sent, block, newest = state.sent_m, state.block_m.copy(), state.newest
    for _ in range(periods_in(dt, params.impedance.period_s)):
        if newest % _BLOCK == _BLOCK - 1:
            sent = sent.copy()
            sent[newest - _BLOCK + 1 : newest + 1] = block
        newest = (newest + 1) % HISTORY
        block[newest % _BLOCK] = signal.position_m
    return MasterState(inner, sent, block, newest, state.estimate, state.in_use_n_per_m), signal


@compiled
def reference_then(state: MasterState, age_s: float, period_s: float) -> float:
    """Return the reference [m] that was sent age_s [s] ago; the oldest stored one if that is longer ago."""
    periods = min(round(age_s / period_s), HISTORY - 1)
    if periods <= state.newest % _BLOCK:
        return float(state.block_m[state.newest % _BLOCK - periods])
    return float(state.sent_m[(state.newest - periods) % HISTORY])


@compiled
def estimated(params: SmithParams, estimate: Estimate, reference_m: float, signal: PortSignal) -> Estimate:
    """Update the estimate of K_e with one pair of reference [m] and force [N]; a new contact clears the memory."""
    if not signal.in_contact:
        return _without_memory(estimate.stiffness_n_per_m)
    if not estimate.in_contact:
        return Estimate(
            mean_m=reference_m,
            mean_n=signal.force_n,
            square_m2=0.0,
            product_n_m=0.0,
            stiffness_n_per_m=estimate.stiffness_n_per_m,
            in_contact=True,
        )
    keep, take = params.forget, 1.0 - params.forget
    off_m, off_n = reference_m - estimate.mean_m, signal.force_n - estimate.mean_n
    square = keep * (estimate.square_m2 + take * off_m * off_m)
    product = keep * (estimate.product_n_m + take * off_m * off_n)
    stiffness = estimate.stiffness_n_per_m
    if params.estimate and square > params.motion_m * params.motion_m:
        stiffness = min(max(product / square, 0.0), params.stiffness_max_n_per_m)
    return Estimate(
        mean_m=estimate.mean_m + take * off_m,
        mean_n=estimate.mean_n + take * off_n,
        square_m2=square,
        product_n_m=product,
        stiffness_n_per_m=stiffness,
        in_contact=True,
    )


@compiled
def master_receive(
    params: SmithParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Integrate the virtual impedance over dt [s] under the predicted force.

    The force in the returned reference is the predicted one too, because the hand feels it.
    """
    p = params.impedance
    may = at_hand(p, hand, signal, False, 0.0, dt, False)
    then = reference_then(state, signal.round_trip_s, p.period_s)
    estimate = estimated(params, state.estimate, then, signal)
    if may.renews:
        # The tip may meet another sample after it is armed again.
        estimate = _without_memory(params.stiffness_n_per_m)
    wanted = estimate.stiffness_n_per_m if signal.in_contact and may.acts else 0.0
    reach = params.rate_n_per_m * periods_in(dt, p.period_s)
    in_use = min(max(wanted, state.in_use_n_per_m - reach), state.in_use_n_per_m + reach)
    now = p.position_scale * state.impedance.position_m + state.impedance.tip_offset_m
    predicted = port_signal(
        position_m=signal.position_m,
        velocity_m_per_s=signal.velocity_m_per_s,
        force_n=signal.force_n + (in_use * (now - then) if may.acts else 0.0),
        separation_m=signal.separation_m,
        separation_valid=signal.separation_valid,
        in_contact=signal.in_contact,
        active=signal.active,
        silence_s=signal.silence_s,
        round_trip_s=signal.round_trip_s,
    )
    inner, reference = _receive(p, state.impedance, hand, predicted, dt)
    return MasterState(inner, state.sent_m, state.block_m, state.newest, estimate, in_use), reference


@compiled
def retune(old: SmithParams, new: SmithParams, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes."""
    inner = _retune(old.impedance, new.impedance, state.impedance)
    return MasterState(inner, state.sent_m, state.block_m, state.newest, state.estimate, state.in_use_n_per_m)


def rest_force(params: SmithParams, force_n: float) -> float:
    """Return the tip force alpha_f F_s [N] at which the impedance rests: at rest the prediction adds no force."""
    assert VIRTUAL_IMPEDANCE.rest_force is not None
    return float(VIRTUAL_IMPEDANCE.rest_force(params.impedance, force_n))


SMITH = Law.of(__name__, SmithConfig, slave=pass_through)
