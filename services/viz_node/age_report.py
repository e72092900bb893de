"""The age of the loop, divided into its parts, for the pages and the metrics."""

import time

from services.viz_node.feed import SeenMessage
from telenano.timing.loop_age import LoopAge, Part

# Interval at which the parts are computed [s].
_AGE_S = 1.0


class AgeReport:
    """Computes the parts of the loop's age once a second; `parts` is empty while no page is open."""

    def __init__(self) -> None:
        self.loop_age, self._taken_s = LoopAge(), time.monotonic()
        self.parts: list[Part] = []

    def record(self, seen: SeenMessage) -> None:
        """Record a message of `AGE_TOPICS`."""
        self.loop_age.take(*seen)

    def take(self, now_s: float, *, is_watched: bool) -> bool:
        """Compute the parts if a second has passed since the last time; return whether they were computed now.

        Args:
            now_s: The monotonic time [s].
            is_watched: Whether a page is open.
        """
        if now_s - self._taken_s < _AGE_S:
            return False
        self._taken_s, self.parts = now_s, self.loop_age.parts() if is_watched else []
        return True
