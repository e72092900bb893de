"""The simulated instrument with the dynamic cantilever of `dynamic`, in the time of the node (ADR 0044)."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.driver import Oscillation
from services.afm_node.physics.contact.electrostatic import electrostatic_strength_n_m2
from services.afm_node.physics.contact.friction import FrictionParams, FrictionState
from services.afm_node.physics.disturbances import DisturbanceConfig, ThermalConfig
from services.afm_node.physics.disturbed import DisturbedAfm
from services.afm_node.physics.dynamic import (
    KICKS_PER_PERIOD,
    NO_NOISE,
    DynamicPlant,
    DynamicState,
    Reading,
    advance,
    free_amplitude_m,
)
from services.afm_node.physics.sample.surface import Surface
from services.afm_node.physics.step import AfmParams, AfmSample
from services.numerics.compiled import always_compiled

# the motion that is gone through while nothing waits for it, of the millisecond between two exchanges, and at a time,
# some 100 us: what shares the processor has to come in between
_AHEAD_S, _SLICE_STEPS = 0.9e-3, 4500
# simulated at once, however late the process is: a machine that is too slow falls behind, and goes on
_MOST_S = 2e-3
_LEAST_PERIODS = 8
# a tip that is not driven has no phase to be met: it comes to rest at any step
_RESTING_STEPS = 32
# of the contact's own motion [rad]: the impulses are unstable beyond 2
_MOST_ANGLE_A_STEP = 1.5
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
) -> tuple[DynamicState, Reading, float, float]:
    """Return the state after an exchange, what was read, and of all of it what the sample took and how long it touched.

    These two are an energy [J] and a share of the time.
    """
    split = steps.moving * KICKS_PER_PERIOD // plant.drive.shape[0] if normals.size > 0 else 0
    taken, touched = 0.0, 0.0
    if steps.moving > 0:
        state, before = advance(plant, state, base_m, surface_m, drive_m, steps.moving, normals[:split])
        taken, touched = before.dissipated_j, before.contact_share * steps.moving
    state, reading = advance(plant, state, base_m, surface_m, drive_m, steps.reading, normals[split:])
    touched += reading.contact_share * steps.reading
    return state, reading, taken + reading.dissipated_j, touched / (steps.moving + steps.reading)


def least_steps(plant: DynamicPlant) -> int:
    """Return the fewest steps a period with which a tip in the steepest force of its sample does not gain energy.

    In the stiffest contact of the grid it swings at w0 sqrt(1 + c / k), and impulses of the force are stable as far as
    two steps a radian (Verlet). Attraction is steepest, 2 A / h^3, where contact begins.
    """
    grid, k = plant.grid, plant.stiffness_n_per_m
    contact_n_per_m = float(np.abs(grid.cubics[2:, :, 1]).max()) * grid.cells_per_m
    attraction_n_per_m = 2.0 * grid.attraction_n_m2 / plant.passages.onset_m**3
    steepest_n_per_m = max(contact_n_per_m, attraction_n_per_m)
    steps = 2.0 * math.pi * math.sqrt(1.0 + steepest_n_per_m / k) / _MOST_ANGLE_A_STEP
    return KICKS_PER_PERIOD * math.ceil(steps / KICKS_PER_PERIOD)


def require_steps(plant: DynamicPlant) -> None:
    """Raise ValueError naming the steps a period that a tip in contact needs, where there are fewer."""
    steps, least = int(plant.drive.shape[0]), least_steps(plant)
    if steps < least:
        raise ValueError(
            f"cantilever.steps_per_period = {steps} is too few for a cantilever of {plant.stiffness_n_per_m:g} N/m,"
            f" which the sample makes swing faster: {least} or more are needed"
        )


def resting_steps(driven: DynamicPlant) -> int:
    """Return the steps a period of a tip that is not driven: as few as its accuracy and its contact allow."""
    return min(max(_RESTING_STEPS, least_steps(driven)), int(driven.drive.shape[0]))


def with_exact_rest(plant: DynamicPlant) -> DynamicPlant:
    """Return a cantilever whose impulses hold a tip exactly where the force would.

    Between two impulses of a force F the spring swings by the angle w0 dt, so that a tip at rest would be found at
    (w0 dt / 2) cot(w0 dt / 2) of F / k: 0.3 % less at 32 steps a period. The impulses have a mass that makes up for it.
    """
    half = 0.5 * math.sqrt(plant.stiffness_n_per_m / plant.mass_kg) * plant.step_s
    return plant._replace(mass_kg=plant.mass_kg * half / math.tan(half))


class DynamicAfm(DisturbedAfm):
    """The simulated AFM whose cantilever follows Eq. 4 in full; made only where numba is installed.

    The cantilever goes through the time that passes, in whole periods of its drive. Most of a millisecond is known
    before the next command, since the base stands: `settle` goes through that while nothing waits for it. An exchange
    has what is left: in the first half of it the base moves to where it is sent, and the second half is what the
    deflection, and of a tip that is driven amplitude and phase, are the mean of. Thermal noise are impulses on the tip.
    """

    settles = True

    def __init__(
        self,
        params: AfmParams,
        surface: Surface | None,
        friction: FrictionParams | None,
        disturbances: DisturbanceConfig,
        driven: DynamicPlant,
        resting: DynamicPlant,
    ) -> None:
        super().__init__(params, surface, friction, disturbances)
        require_steps(driven)
        self._driven, self._resting = driven, with_exact_rest(resting)
        self._drive_m = 0.0
        self._due_s = 0.0
        self._calls = 0
        self._in_phase_m = self._quadrature_m = self._dissipated_j = 0.0
        self._taken_j, self._periods = 0.0, 0
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
        drive_m = amplitude_m / free_amplitude_m(self._driven, 1.0)
        if (drive_m == 0.0) != (self._drive_m == 0.0):
            # the steps are others, so it begins a period
            self._motion = self._motion._replace(phase_step=0)
        self._drive_m = drive_m

    @property
    def oscillation(self) -> Oscillation:
        if self._drive_m == 0.0:
            return Oscillation(0.0, 0.0)
        x, y = self._in_phase_m, self._quadrature_m
        return Oscillation(math.hypot(x, y), math.atan2(y, x), self._dissipated_j)

    @property
    def _dynamic(self) -> DynamicPlant:
        return self._driven if self._drive_m > 0.0 else self._resting

    def settle(self) -> bool:
        plant = self._dynamic
        n, period_s = int(plant.drive.shape[0]), 1.0 / plant.drive_hz
        ahead_s, slice_s = self._due_s + _AHEAD_S, _SLICE_STEPS // n * period_s
        periods = int(min(ahead_s, slice_s) / period_s)
        if periods > 0:
            self._due_s -= periods * period_s
            steps = periods * n
            self._go_on(self._motion.base_m, self._motion.surface_m, Exchange(0, steps), periods)
        # a small rest is as well gone through with the next command
        return ahead_s - periods * period_s > 0.5 * slice_s

    def _respond(self, base_m: float) -> AfmSample:
        plant, height = self._dynamic, self._height_m
        period_s = 1.0 / plant.drive_hz
        most = max(int(_MOST_S / period_s), _LEAST_PERIODS)
        periods = min(max(int(self._due_s / period_s), _LEAST_PERIODS), most)
        # neither a debt that grows nor a lead
        self._due_s = min(max(self._due_s - periods * period_s, -_MOST_S), period_s)
        n = int(plant.drive.shape[0])
        moving = periods // 2
        reading, touched = self._go_on(base_m, height, Exchange(moving * n, (periods - moving) * n), periods)
        self._in_phase_m, self._quadrature_m = reading.in_phase_m, reading.quadrature_m
        # of all periods since the last exchange: a meniscus may form and break in each second or third of them only
        self._dissipated_j, self._taken_j, self._periods = self._taken_j / self._periods, 0.0, 0
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

    def _go_on(self, base_m: float, surface_m: float, steps: Exchange, periods: int) -> tuple[Reading, float]:
        plant = self._dynamic
        if self._voltage_v != 0.0:
            strength = electrostatic_strength_n_m2(self._voltage_v, plant.tip_radius_m)
            plant = plant._replace(electrostatic_n_m2=strength)
        kicks = self._kicks(periods)
        self._motion, reading, taken_j, touched = exchanged(
            plant, self._motion, base_m, surface_m, self._drive_m, steps, kicks
        )
        self._taken_j, self._periods = self._taken_j + taken_j, self._periods + periods
        self._calls += 1
        return reading, touched

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
        source = np.random.Philox(key=config.seed, counter=[0, 0, self._calls, _KICKS])
        scale = math.sqrt(config.thermal.temperature_k)
        return scale * np.random.Generator(source).standard_normal(periods * KICKS_PER_PERIOD)


def _without_thermal(config: DisturbanceConfig) -> DisturbanceConfig:
    return config.model_copy(update={"thermal": ThermalConfig()})
