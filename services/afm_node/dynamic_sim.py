"""The simulated instrument with the dynamic cantilever of `dynamic`, in the time of the node (ADR 0044)."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.disturbances import DisturbanceConfig, ThermalConfig
from services.afm_node.disturbed import DisturbedAfm
from services.afm_node.driver import Oscillation
from services.afm_node.dynamic import (
    KICKS_PER_PERIOD,
    NO_NOISE,
    DynamicPlant,
    DynamicState,
    Reading,
    advance,
    free_amplitude_m,
)
from services.afm_node.electrostatic import electrostatic_strength_n_m2
from services.afm_node.friction import FrictionParams, FrictionState
from services.afm_node.step import AfmParams, AfmSample
from services.afm_node.surface import Surface
from services.runtime.compiled import always_compiled

# share of an exchange in which the base stands and the deflection is read
_READING_SHARE = 0.25
# simulated at once, however late the process is: a machine that is too slow falls behind, and goes on
_MOST_S = 2e-3
_LEAST_PERIODS = 8
# of the counters of Philox: the other numbers of the seed have 0 and 1
_KICKS = 2


class Exchange(NamedTuple):
    """Steps in which base and surface move evenly to where they are sent, and steps after that, in which is read."""

    moving: int
    reading: int


@always_compiled
def exchanged(
    plant: DynamicPlant,
    state: DynamicState,
    base_m: float,
    surface_m: float,
    drive_m: float,
    steps: Exchange,
    normals: npt.NDArray[np.float64],
) -> tuple[DynamicState, Reading, float]:
    """Return the state after an exchange, what was read, and the share of all of it that the tip touched the sample."""
    split = steps.moving * KICKS_PER_PERIOD // plant.drive.shape[0] if normals.size > 0 else 0
    state, before = advance(plant, state, base_m, surface_m, drive_m, steps.moving, normals[:split])
    state, reading = advance(plant, state, base_m, surface_m, drive_m, steps.reading, normals[split:])
    whole = steps.moving + steps.reading
    touched = (before.contact_share * steps.moving + reading.contact_share * steps.reading) / whole
    return state, reading, touched


class DynamicAfm(DisturbedAfm):
    """The simulated AFM whose cantilever follows Eq. 4 in full; made only where numba is installed.

    In each exchange the cantilever goes through the time since the one before, in whole periods of its drive. The base
    is where it was sent after three quarters of them; the last quarter is what the deflection, and of a tip that is
    driven amplitude and phase, are the mean of. Thermal noise are impulses on the tip.
    """

    def __init__(
        self,
        params: AfmParams,
        surface: Surface | None,
        friction: FrictionParams | None,
        disturbances: DisturbanceConfig,
        plant: DynamicPlant,
    ) -> None:
        super().__init__(params, surface, friction, disturbances)
        self._dynamic = plant
        self._drive_m = 0.0
        self._due_s = 0.0
        self._exchanges = 0
        self._in_phase_m = self._quadrature_m = 0.0
        self._motion = DynamicState(0.0, 0.0, self._safe_position_m, 0.0, self._height_m, False, False, 0)
        self._electronic = _without_thermal(disturbances)

    def configure(self, config: DisturbanceConfig) -> None:
        super().configure(config)
        self._electronic = _without_thermal(config)

    def open(self) -> None:
        super().open()
        assert self._tip is not None
        base = self._safe_position_m
        zeta = self._tip.distance_m + base + self._height_m - self._plant.rest_distance_m
        self._motion = DynamicState(zeta, 0.0, base, 0.0, self._height_m, self._tip.contact, self._tip.meniscus, 0)

    def elapse(self, dt: float) -> None:
        super().elapse(dt)
        self._due_s += dt

    def vibrate(self, amplitude_m: float) -> None:
        """Drive the base so that the amplitude without a sample becomes amplitude_m [m]; 0 lets the tip come to rest.

        Raises: ValueError, if that is negative or not finite.
        """
        if not (math.isfinite(amplitude_m) and amplitude_m >= 0.0):
            raise ValueError(f"amplitude = {amplitude_m} m must be finite and >= 0 m")
        self._drive_m = amplitude_m / free_amplitude_m(self._dynamic, 1.0)

    @property
    def oscillation(self) -> Oscillation:
        if self._drive_m == 0.0:
            return Oscillation(0.0, 0.0)
        x, y = self._in_phase_m, self._quadrature_m
        return Oscillation(math.hypot(x, y), math.atan2(y, x))

    def _respond(self, base_m: float) -> AfmSample:
        plant, height = self._dynamic, self._height_m
        period_s = 1.0 / plant.drive_hz
        periods = int(self._due_s / period_s)
        self._due_s = max(self._due_s - periods * period_s, 0.0)
        periods = min(max(periods, _LEAST_PERIODS), max(int(_MOST_S / period_s), _LEAST_PERIODS))
        n = int(plant.drive.shape[0])
        read = max(round(_READING_SHARE * periods), 1)
        steps = Exchange((periods - read) * n, read * n)
        if self._voltage_v != 0.0:
            strength = electrostatic_strength_n_m2(self._voltage_v, plant.tip_radius_m)
            plant = plant._replace(electrostatic_n_m2=strength)
        self._motion, reading, touched = exchanged(
            plant, self._motion, base_m, height, self._drive_m, steps, self._kicks(periods)
        )
        self._exchanges += 1
        self._in_phase_m, self._quadrature_m = reading.in_phase_m, reading.quadrature_m
        zeta = reading.mean_deflection_m
        return AfmSample(
            base_m + height,
            zeta,
            plant.stiffness_n_per_m * zeta,
            self._plant.volts_per_m * zeta,
            plant.rest_distance_m + zeta - base_m - height,
            True,
            touched > 0.0,
            self._motion.meniscus,
        )

    def _rub(self, sample: AfmSample) -> None:
        if self._drive_m == 0.0:
            super()._rub(sample)
            return
        # a tapping tip lets go in each period
        self._place_before, self._held, self._lateral_force_n = self._place, FrictionState(0.0, 0.0), (0.0, 0.0)

    def _read_out_config(self) -> DisturbanceConfig:
        return self._electronic

    def _kicks(self, periods: int) -> npt.NDArray[np.float64]:
        """Return the thermal impulses of so many periods; the plant was built for 1 K."""
        config = self.disturbances
        if not config.thermal.enabled:
            return NO_NOISE
        source = np.random.Philox(key=config.seed, counter=[0, 0, self._exchanges, _KICKS])
        scale = math.sqrt(config.thermal.temperature_k)
        return scale * np.random.Generator(source).standard_normal(periods * KICKS_PER_PERIOD)


def _without_thermal(config: DisturbanceConfig) -> DisturbanceConfig:
    return config.model_copy(update={"thermal": ThermalConfig()})
