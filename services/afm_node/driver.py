"""The interface of an AFM device. The simulated one is `sim.SimulatedAfm`; a real one is another class of this shape.

A driver moves and measures, no more: what may be sent to it is decided before, by `safety.safety_step`.
"""

from typing import Protocol

from services.afm_node.step import AfmSample


class AfmDriver(Protocol):
    """One AFM: a base that can be moved, a deflection that can be read."""

    @property
    def safe_position_m(self) -> float:
        """Base position [m] of the safe state: retracted."""

    def open(self) -> None:
        """Connect, and put the device into its safe state.

        Raises: OSError, if the device cannot be reached; RuntimeError, if it is already open.
        """

    def exchange(self, base_m: float) -> AfmSample:
        """Apply a base position [m] and return what the device measured; blocks for one device cycle at most.

        Raises: ValueError, if the position is not finite; OSError, if the device is lost; RuntimeError, if not open.
        """

    def retract(self) -> None:
        """Go to the safe state at once. Called on every way out, so it must work after an error of `exchange`."""

    def close(self) -> None:
        """Go to the safe state and disconnect; harmless when already closed."""
