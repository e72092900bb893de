"""The simulated instrument with disturbances: without any that is switched on it is the instrument itself."""

from services.afm_node.physics.contact.electrostatic import (
    MOST_TURNS,
    SETTLED_M,
    electrostatic_force_n,
    electrostatic_strength_n_m2,
)
from services.afm_node.physics.contact.friction import FrictionParams
from services.afm_node.physics.disturbances import (
    DisturbanceConfig,
    DisturbanceState,
    at_rest,
    begun,
    charged,
    displaced,
    read_out,
    sines_of,
)
from services.afm_node.physics.sample.surface import Surface
from services.afm_node.physics.sim import SimulatedAfm
from services.afm_node.physics.step import AfmParams, AfmSample
from services.numerics.normal_numbers import NormalNumbers


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
        self._voltage_v = 0.0
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

    # whether there is work that nothing has to wait for, between two exchanges
    settles = False

    def settle(self) -> bool:
        """Go on by a part of what can be known of the motion before the next exchange; return whether there is more."""
        return False

    def exchange(self, base_m: float) -> AfmSample:
        if not self._active:
            self._voltage_v = 0.0
            return super().exchange(base_m)
        config, plant = self.disturbances, self._plant
        dt, self._elapsed_s = self._elapsed_s, 0.0
        state = self._disturbance_state
        if self._is_new:
            state, self._is_new = at_rest(state, base_m), False
        state, piezo_m = displaced(config, self._sines, state, base_m, dt)
        state, self._voltage_v = charged(config.electrostatic, self._normals, state, dt)
        sample = super().exchange(piezo_m)
        k, gain = plant.stiffness_n_per_m, plant.volts_per_m
        read = self._read_out_config()
        self._disturbance_state, zeta = read_out(read, self._normals, state, sample.deflection_m, k, gain, dt)
        return sample._replace(base_m=base_m, deflection_m=zeta, force_n=k * zeta, bridge_voltage_v=gain * zeta)

    def _respond(self, base_m: float) -> AfmSample:
        """Move the base [m] of a tip that a voltage pulls on as well: k zeta = F(h) + F_el(h).

        A force F_el bends the cantilever as a base does that is nearer by -F_el / k. It grows as the tip comes nearer,
        so the turns go one way only, to the next equilibrium, and over the edge where there is none: a pull-in.
        """
        if self._voltage_v == 0.0 or self._tip is None:
            return super()._respond(base_m)
        k, tip = self._plant.stiffness_n_per_m, self._plant.tip
        strength = electrostatic_strength_n_m2(self._voltage_v, tip.radius_m)
        for _ in range(MOST_TURNS):
            before_m = self._tip.distance_m
            pull_m = electrostatic_force_n(strength, tip.radius_m, tip.contact_distance_m, before_m) / k
            sample = super()._respond(base_m - pull_m)
            if abs(self._tip.distance_m - before_m) < SETTLED_M:
                break
        zeta = sample.deflection_m + pull_m
        return sample._replace(
            base_m=sample.base_m + pull_m,
            deflection_m=zeta,
            force_n=k * zeta,
            bridge_voltage_v=self._plant.volts_per_m * zeta,
        )

    def _read_out_config(self) -> DisturbanceConfig:
        """Return what disturbs the deflection after the cantilever."""
        return self.disturbances
