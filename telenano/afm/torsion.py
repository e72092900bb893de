"""The torsion channel, which measures the lateral force on the tip: a part around any other part.

The voltage of the photodiode belongs to the torsion of the cantilever, with a share of its bending (crosstalk), because
diode and cantilever are never quite parallel. The calibration factor C [N/V] turns it into a force, with an error e:

    F = clip((1 + e) (F_lateral + c k zeta), +-C U),  U the range of the read-out

c k zeta is the apparent lateral force of a bent cantilever. Everything after this part (guard, programs, hand, images)
sees only the measured force; layers on the sample obey the true one.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from telenano.afm.part import Motion, Part, motion_of, part_start, part_step, register_part, truths_of
from telenano.extend.samples import AfmSample, Oscillation, PlantInputs
from telenano.numerics.compiler import compiled


class TorsionParams(NamedTuple):
    """The inner part; gain 1 + e; apparent lateral force per deflection in x and y [N/m]; greatest force read [N]."""

    within: Any
    gain: float
    cross_x_n_per_m: float
    cross_y_n_per_m: float
    most_n: float


@compiled
def _read(params: TorsionParams, force_n: float, cross_n_per_m: float, deflection_m: float) -> float:
    """Return the reading of the channel along one axis [N]."""
    return min(max(params.gain * (force_n + cross_n_per_m * deflection_m), -params.most_n), params.most_n)


@compiled
def _step(params: TorsionParams, state: Any, inputs: PlantInputs, dt: float) -> tuple[Any, AfmSample]:
    within, sample = part_step(params.within, state, inputs, dt)
    return within, AfmSample(
        base_m=sample.base_m,
        deflection_m=sample.deflection_m,
        force_n=sample.force_n,
        bridge_voltage_v=sample.bridge_voltage_v,
        distance_m=sample.distance_m,
        distance_valid=sample.distance_valid,
        in_contact=sample.in_contact,
        meniscus=sample.meniscus,
        lateral_x_n=_read(params, sample.lateral_x_n, params.cross_x_n_per_m, sample.deflection_m),
        lateral_y_n=_read(params, sample.lateral_y_n, params.cross_y_n_per_m, sample.deflection_m),
    )


def _start(params: TorsionParams, inputs: PlantInputs) -> Any:
    return part_start(params.within, inputs)


def _motion(params: TorsionParams) -> Motion | None:
    inner = motion_of(params.within)
    if inner is None:
        return None

    def settle(params: TorsionParams, state: Any, inputs: PlantInputs) -> tuple[Any, bool]:
        return inner.settle(params.within, state, inputs)

    def oscillation(state: Any) -> Oscillation:
        return inner.oscillation(state)

    return Motion(settle, oscillation)


def _truths(params: TorsionParams, state: Any) -> Mapping[str, Any]:
    return truths_of(params.within, state)


register_part(TorsionParams, Part(_start, _step, motion=_motion, truths=_truths))
