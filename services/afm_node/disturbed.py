"""The simulated instrument with disturbances: without any that is switched on it is the instrument itself."""

from services.afm_node.disturbances import (
    DisturbanceConfig,
    DisturbanceState,
    at_rest,
    begun,
    displaced,
    read_out,
    sines_of,
)
from services.afm_node.friction import FrictionParams
from services.afm_node.sim import SimulatedAfm
from services.afm_node.step import AfmParams, AfmSample
from services.afm_node.surface import Surface
from services.runtime.normal_numbers import NormalNumbers


class DisturbedAfm(SimulatedAfm):
    """The simulated AFM whose base and read-out are disturbed.

    What is reported of the base is what it was sent to: an open-loop piezo knows no better. A part of the instrument
    and not a driver around it, so that journals of nodes without disturbances describe the same object.
    """

    def __init__(
        self,
        params: AfmParams,
        surface: Surface | None,
        friction: FrictionParams | None,
        config: DisturbanceConfig,
    ) -> None:
        super().__init__(params, surface, friction)
        self.disturbances = config
        self._disturbance_state: DisturbanceState = begun()
        self._normals, self._sines = NormalNumbers(config.seed), sines_of(config)
        self._active = config.any_enabled
        self._elapsed_s = 0.0
        # what creeps and lags behind is at rest where the base is when it is switched on
        self._is_new = True

    def configure(self, config: DisturbanceConfig) -> None:
        """Take other disturbances from now on; those that go on keep their state."""
        if not self._active:
            self._elapsed_s, self._is_new = 0.0, True
        self._sines = sines_of(config)
        self._normals.reseed(config.seed)
        self.disturbances, self._active = config, config.any_enabled

    def elapse(self, dt: float) -> None:
        """Note the time [s] of the next exchange."""
        self._elapsed_s += dt

    def exchange(self, base_m: float) -> AfmSample:
        if not self._active:
            return super().exchange(base_m)
        config, plant = self.disturbances, self._plant
        dt, self._elapsed_s = self._elapsed_s, 0.0
        state = self._disturbance_state
        if self._is_new:
            state, self._is_new = at_rest(state, base_m), False
        state, piezo_m = displaced(config, self._sines, state, base_m, dt)
        sample = super().exchange(piezo_m)
        k, gain = plant.stiffness_n_per_m, plant.volts_per_m
        self._disturbance_state, zeta = read_out(config, self._normals, state, sample.deflection_m, k, gain, dt)
        return sample._replace(base_m=base_m, deflection_m=zeta, force_n=k * zeta, bridge_voltage_v=gain * zeta)
