"""The driver of every simulated instrument: it puts any part (`part`) behind the driver protocol of the node."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from telenano.afm.cantilever import Plant
from telenano.afm.contact.friction import FrictionParams
from telenano.afm.disturbances import NoiseState, noise_start, noise_step
from telenano.afm.disturbed import (
    DisturbedState,
    PiezoState,
    disturbed_params,
    disturbed_step,
    gauged,
    piezo_at_rest,
    piezo_switched,
)
from telenano.afm.over_surface import over_surface
from telenano.afm.part import motion_of, part_of, part_start, part_step, truths_of
from telenano.afm.sample.surface import Surface
from telenano.afm.spring import SpringParams, spring_params
from telenano.afm.step import AfmParams
from telenano.extend.instruments import LateralStage, Relief, Simulation, VibratingCantilever
from telenano.extend.samples import AfmSample, Oscillation, PlantInputs
from telenano.settings.afm_disturbances import DisturbanceConfig

_AT_REST = Oscillation(0.0, 0.0)
_QUIET = DisturbanceConfig()


class InstrumentState(msgspec.Struct, array_like=True):
    """The whole state of a simulated instrument.

    inputs: inputs of the last step, but place of the tip, drive and thermal noise of the next one; disturbances: their
    settings; noise: state of their random numbers; part: state of the part, None while the instrument is closed; piezo:
    state of the piezo, None until a disturbance acts; elapsed_s: time since the last step [s]; lateral_n: force on the
    tip in x and y at the last step [N].
    """

    inputs: PlantInputs
    disturbances: DisturbanceConfig
    noise: NoiseState
    part: Any = None
    piezo: PiezoState | None = None
    elapsed_s: float = 0.0
    lateral_n: tuple[float, float] = (0.0, 0.0)


class SimulatedInstrument:
    """An `AfmDriver` whose device is a part.

    Args:
        params: The parameters: the plant to simulate, and the limits, whose retract position is the safe state.
        relief: The known heights of the surface; None if nothing is known.
        cantilever: The cantilever of an instrument that can be disturbed; None for one that cannot.
        disturbances: The disturbances of the instrument.
        about: A remark on the sample for the person who arms the tip.
        channel: The channel of `felt` that the part measures besides the deflection; empty for none.
        is_gauged: Whether the part gives only a force, which the cantilever reads while it is disturbed.
    """

    def __init__(
        self,
        params: AfmParams,
        relief: Relief | None = None,
        cantilever: Plant | None = None,
        disturbances: DisturbanceConfig = _QUIET,
        about: str = "",
        channel: str = "",
        *,
        is_gauged: bool = False,
    ) -> None:
        self._params, self._is_gauged = params, is_gauged
        self.about, self._channel = about, channel
        self._relief, self._cantilever = relief, cantilever
        self._motion = motion_of(params.plant)
        self.state = InstrumentState(
            _thermal(PlantInputs(self.safe_position_m), disturbances, moves=self._motion is not None),
            disturbances,
            noise_start(),
        )

    @property
    def safe_position_m(self) -> float:
        return self._params.safety.retract_position_m

    @property
    def latency_s(self) -> float:
        return 0.0

    @property
    def calibration_identity(self) -> str:
        return ""

    @property
    def report(self) -> None:
        return None

    @property
    def stage(self) -> LateralStage | None:
        return self if part_of(self._params.plant).lateral else None

    @property
    def vibration(self) -> VibratingCantilever | None:
        return None if self._motion is None else self

    @property
    def simulation(self) -> Simulation | None:
        return self

    @property
    def relief(self) -> Relief | None:
        return self._relief

    def move_to(self, x_m: float, y_m: float) -> None:
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            raise ValueError(f"lateral position {x_m}, {y_m} m must be finite")
        self.state.inputs = self.state.inputs._replace(x_m=x_m, y_m=y_m)

    @property
    def lateral_force_n(self) -> tuple[float, float]:
        return self.state.lateral_n

    def vibrate(self, amplitude_m: float) -> None:
        """Drive the base so that the amplitude without a sample becomes amplitude_m [m]; 0 stops the drive.

        Raises:
            ValueError: The amplitude is negative or not finite.
        """
        if not (math.isfinite(amplitude_m) and amplitude_m >= 0.0):
            raise ValueError(f"amplitude = {amplitude_m} m must be finite and >= 0 m")
        self.state.inputs = self.state.inputs._replace(amplitude_m=amplitude_m)

    @property
    def oscillation(self) -> Oscillation:
        state = self.state
        if self._motion is None or state.part is None or state.inputs.amplitude_m == 0.0:
            return _AT_REST
        return self._motion.oscillation(state.part)

    @property
    def channels(self) -> dict[str, float]:
        """Return the channels measured at the last exchange besides the deflection, in SI units, by name."""
        values = {}
        if self._motion is not None:
            values = {"amplitude": self.oscillation.amplitude_m, "phase": self.oscillation.phase_rad}
        if self._channel and self.state.part is not None:
            values[self._channel] = self.state.part.value
        return values

    @property
    def disturbances(self) -> DisturbanceConfig | None:
        return None if self._cantilever is None else self.state.disturbances

    def configure(self, config: DisturbanceConfig) -> None:
        """Use other disturbances from now on; those that continue keep their state."""
        state = self.state
        if not state.disturbances.any_enabled:
            # Creep and hysteresis begin at rest, where the base is when they are switched on.
            state.piezo, state.elapsed_s = None, 0.0
        if state.piezo is not None:
            state.piezo = piezo_switched(state.piezo, state.disturbances, config, state.inputs.base_m)
        state.inputs = _thermal(state.inputs, config, moves=self._motion is not None)
        state.disturbances = config

    @property
    def is_spring(self) -> bool:
        """Return whether the environment is a spring."""
        return isinstance(self._params.plant, SpringParams)

    def take_spring(self, stiffness_n_per_m: float) -> None:
        """Change the stiffness of the environment [N/m], which must be a spring."""
        plant = self._params.plant
        changed = spring_params(stiffness_n_per_m, plant.rest_distance_m, plant.bilateral)
        self._params = self._params._replace(plant=changed)

    def restore_sample(self) -> None:
        """Restore the sample to its initial state: particles at their first places, and no history."""
        state = self.state
        if state.part is not None:
            state.part = part_start(self._params.plant, state.inputs)

    def elapse(self, dt: float) -> None:
        """Add dt [s] to the time that the next exchange simulates."""
        self.state.elapsed_s += dt

    @property
    def truths(self) -> Mapping[str, Any]:
        return {} if self.state.part is None else truths_of(self._params.plant, self.state.part)

    @property
    def settles(self) -> bool:
        return self._motion is not None

    def settle(self) -> bool:
        state = self.state
        if self._motion is None or state.part is None:
            return False
        state.part, continues = self._motion.settle(self._params.plant, state.part, state.inputs)
        return continues

    def open(self) -> None:
        """Start at rest in the safe position.

        Raises:
            RuntimeError: The device is already open.
        """
        state = self.state
        if state.part is not None:
            raise RuntimeError("the simulated instrument is already open")
        inputs = state.inputs._replace(base_m=self.safe_position_m)
        state.part = part_start(self._params.plant, inputs)

    def exchange(self, base_m: float) -> AfmSample:
        state = self.state
        if state.part is None:
            raise RuntimeError("the simulated instrument is not open: call open() first")
        if not math.isfinite(base_m):
            raise ValueError(f"base position {base_m} m must be finite")
        inputs = state.inputs._replace(base_m=base_m, voltage_v=0.0)
        if self._cantilever is not None and state.disturbances.any_enabled:
            sample = self._disturbed(self._cantilever, inputs)
        else:
            state.part, sample = part_step(self._params.plant, state.part, inputs, state.elapsed_s)
            state.inputs = inputs
        state.elapsed_s, state.lateral_n = 0.0, (sample.lateral_x_n, sample.lateral_y_n)
        return sample

    def _disturbed(self, cantilever: Plant, inputs: PlantInputs) -> AfmSample:
        state, config = self.state, self.state.disturbances
        tip = gauged(self._params.plant, cantilever) if self._is_gauged else self._params.plant
        # For a dynamic cantilever the thermal noise acts as impulses on its tip instead.
        drawn = config if self._motion is None else config.model_copy(update={"thermal": _QUIET.thermal})
        noise_state, noise = noise_step(drawn, state.noise, cantilever.stiffness_n_per_m, state.elapsed_s)
        piezo = piezo_at_rest(inputs.base_m) if state.piezo is None else state.piezo
        moved, sample = disturbed_step(
            disturbed_params(config, tip, cantilever), DisturbedState(state.part, piezo), inputs, noise, state.elapsed_s
        )
        state.inputs = inputs._replace(voltage_v=noise.voltage_v)
        state.noise, state.part, state.piezo = noise_state, moved.tip, moved.piezo
        return sample

    def retract(self) -> bool:
        """Retract to the safe position at once, since a simulated base needs no time; return True."""
        if self.state.part is not None:
            self.exchange(self.safe_position_m)
        return True

    def close(self) -> None:
        self.retract()
        self.state.part = None


def _thermal(inputs: PlantInputs, config: DisturbanceConfig, *, moves: bool) -> PlantInputs:
    """Return the inputs with temperature and seed of the thermal impulses, 0 K unless the cantilever is dynamic."""
    temperature_k = config.thermal.temperature_k if moves and config.thermal.enabled else 0.0
    return inputs._replace(temperature_k=temperature_k, seed=config.seed)


def simulated_afm(
    params: AfmParams,
    surface: Surface | None = None,
    friction: FrictionParams | None = None,
    disturbances: DisturbanceConfig = _QUIET,
    tip: Any = None,
    layer: Callable[[Any, Surface | None], Any] | None = None,
    above_m: float = 0.0,
) -> SimulatedInstrument:
    """Return the simulated AFM.

    Args:
        params: The parameters of the quasi-static cantilever.
        surface: The surface as the tip sees it; None is a plane at height 0.
        friction: The parameters of friction; None is without friction.
        disturbances: The disturbances, which may be switched on while it runs.
        tip: The parameters of a dynamic cantilever; None for the quasi-static one.
        layer: Function from the part over the surface and the surface to the part with a layer; None for no layer.
        above_m: The greatest height of the layer above the surface [m].
    """
    part = over_surface(params.plant if tip is None else tip, surface, friction)
    if layer is not None:
        part = layer(part, surface)
    return SimulatedInstrument(params._replace(plant=part), Relief(surface, above_m), params.plant, disturbances)
