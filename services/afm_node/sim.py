"""The simulated instruments: the compiled plants behind the driver protocol."""

import math

from services.afm_node.cantilever import PlantState, initial_state
from services.afm_node.spring import SpringParams, spring_force
from services.afm_node.step import AfmParams, AfmSample, measure


class SimulatedAfm:
    """An `AfmDriver` whose device is the quasi-static cantilever of `cantilever`, without noise.

    Parameters: params, whose plant is simulated and whose retract position is the safe state.
    """

    def __init__(self, params: AfmParams) -> None:
        self._plant = params.plant
        self._safe_position_m = params.safety.retract_position_m
        self._tip: PlantState | None = None

    @property
    def safe_position_m(self) -> float:
        return self._safe_position_m

    @property
    def latency_s(self) -> float:
        return 0.0

    @property
    def report(self) -> None:
        return None

    def open(self) -> None:
        """Start with the tip in equilibrium at the safe position.

        Raises: RuntimeError, if it is already open.
        """
        if self._tip is not None:
            raise RuntimeError("the simulated AFM is already open")
        self._tip = initial_state(self._plant, self._safe_position_m)

    def exchange(self, base_m: float) -> AfmSample:
        if self._tip is None:
            raise RuntimeError("the simulated AFM is not open: call open() first")
        self._tip, sample = measure(self._plant, self._tip, base_m)
        return sample

    def retract(self) -> bool:
        if self._tip is not None:
            self.exchange(self._safe_position_m)
        return True

    def close(self) -> None:
        self.retract()
        self._tip = None


class SimulatedSpring:
    """An `AfmDriver` whose tip meets a linear spring, F = K (x_s - L), in place of cantilever and sample.

    It has no deflection of its own: the force is that of the spring, and the distance reported is L - x_s.
    """

    def __init__(self, params: SpringParams) -> None:
        self._params = params
        self._opened = False

    @property
    def safe_position_m(self) -> float:
        return self._params.safety.retract_position_m

    @property
    def latency_s(self) -> float:
        return 0.0

    @property
    def report(self) -> None:
        return None

    def open(self) -> None:
        """Start at the safe position. Raises RuntimeError if it is already open."""
        if self._opened:
            raise RuntimeError("the simulated spring is already open")
        self._opened = True

    def exchange(self, base_m: float) -> AfmSample:
        if not self._opened:
            raise RuntimeError("the simulated spring is not open: call open() first")
        if not math.isfinite(base_m):
            raise ValueError(f"base position {base_m} m must be finite")
        force = spring_force(self._params, base_m)
        return AfmSample(base_m, 0.0, force, 0.0, self._params.rest_distance_m - base_m, True, force != 0.0, False)

    def retract(self) -> bool:
        """Retract to the safe position at once: there is nothing to move."""
        return True

    def close(self) -> None:
        self._opened = False
