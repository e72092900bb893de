"""The simulated AFM: the compiled plant behind the driver protocol."""

from services.afm_node.cantilever import PlantState, initial_state
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
        """Base position [m] of the safe state: retracted."""
        return self._safe_position_m

    def open(self) -> None:
        """Start with the tip in equilibrium at the safe position.

        Raises: RuntimeError, if it is already open.
        """
        if self._tip is not None:
            raise RuntimeError("the simulated AFM is already open")
        self._tip = initial_state(self._plant, self._safe_position_m)

    def exchange(self, base_m: float) -> AfmSample:
        """Apply a base position [m] and give what the device measured.

        Raises: ValueError, if the position is not finite; RuntimeError, if not open.
        """
        if self._tip is None:
            raise RuntimeError("the simulated AFM is not open: call open() first")
        self._tip, sample = measure(self._plant, self._tip, base_m)
        return sample

    def retract(self) -> None:
        """Go to the safe position at once."""
        if self._tip is not None:
            self.exchange(self._safe_position_m)

    def close(self) -> None:
        """Go to the safe position and stop; harmless when already closed."""
        self.retract()
        self._tip = None
