"""The simulated instruments: the compiled plants behind the driver protocol."""

import math

from services.afm_node.driver import LateralStage
from services.afm_node.physics.cantilever import PlantState, initial_state
from services.afm_node.physics.contact.friction import FrictionParams, FrictionState, friction_step
from services.afm_node.physics.sample.surface import Surface, height_at
from services.afm_node.physics.spring import SpringParams, spring_force
from services.afm_node.physics.step import AfmParams, AfmSample, measure

# slopes alone
_SMOOTH = FrictionParams(0.0, 0.0, 1.0, 1.0)


class SimulatedAfm:
    """An `AfmDriver` whose device is the quasi-static cantilever of `cantilever`, without noise.

    Parameters: params, whose plant is simulated and whose retract position is the safe state; surface, as the tip sees
    it, None for a plane at height 0; friction, None for none. The tip follows the stage: what friction holds it back
    moves it less than a pixel.
    """

    def __init__(
        self, params: AfmParams, surface: Surface | None = None, friction: FrictionParams | None = None
    ) -> None:
        self._plant = params.plant
        self._safe_position_m = params.safety.retract_position_m
        self._tip: PlantState | None = None
        self._surface, self._friction = surface, friction
        self._has_lateral_force = surface is not None or (friction is not None and friction.coefficient > 0.0)
        self._place = self._place_before = (0.0, 0.0)
        self._height_m, self._slope = _height(surface, 0.0, 0.0)
        self._held = FrictionState(0.0, 0.0)
        self._lateral_force_n = (0.0, 0.0)

    @property
    def safe_position_m(self) -> float:
        return self._safe_position_m

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
    def stage(self) -> LateralStage:
        return self

    @property
    def surface(self) -> Surface | None:
        """The surface as the tip sees it, None for a plane at height 0."""
        return self._surface

    def move_to(self, x_m: float, y_m: float) -> None:
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            raise ValueError(f"lateral position {x_m}, {y_m} m must be finite")
        self._place = (x_m, y_m)
        self._height_m, self._slope = _height(self._surface, x_m, y_m)

    @property
    def lateral_force_n(self) -> tuple[float, float]:
        return self._lateral_force_n

    def open(self) -> None:
        """Start with the tip in equilibrium at the safe position.

        Raises: RuntimeError, if it is already open.
        """
        if self._tip is not None:
            raise RuntimeError("the simulated AFM is already open")
        self._tip = initial_state(self._plant, self._safe_position_m + self._height_m)

    def exchange(self, base_m: float) -> AfmSample:
        if self._tip is None:
            raise RuntimeError("the simulated AFM is not open: call open() first")
        sample = self._respond(base_m)
        if self._has_lateral_force:
            self._rub(sample)
        return sample if self._height_m == 0.0 else sample._replace(base_m=base_m)

    def _respond(self, base_m: float) -> AfmSample:
        """Move the base [m] and return what the cantilever does; the base of the sample counts from the surface."""
        assert self._tip is not None
        # a surface that rises is to the tip a base that comes nearer
        self._tip, sample = measure(self._plant, self._tip, base_m + self._height_m)
        return sample

    def _rub(self, sample: AfmSample) -> None:
        """Find the lateral force where the tip is, which the motion since the last exchange has built up."""
        (x, y), (x0, y0) = self._place, self._place_before
        self._place_before = self._place
        friction = self._friction or _SMOOTH
        self._held, force_x, force_y = friction_step(
            friction, self._held, x - x0, y - y0, sample.force_n, *self._slope, sample.in_contact
        )
        self._lateral_force_n = (force_x, force_y)

    def retract(self) -> bool:
        if self._tip is not None:
            self.exchange(self._safe_position_m)
        return True

    def close(self) -> None:
        self.retract()
        self._tip = None


def _height(surface: Surface | None, x_m: float, y_m: float) -> tuple[float, tuple[float, float]]:
    """Return height [m] and slopes at a place whose 0, 0 is the middle of the map."""
    if surface is None:
        return 0.0, (0.0, 0.0)
    height, slope_x, slope_y = height_at(*surface, x_m + 0.5 * surface.width_m, y_m + 0.5 * surface.depth_m)
    return float(height), (float(slope_x), float(slope_y))


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
    def calibration_identity(self) -> str:
        return ""

    @property
    def report(self) -> None:
        return None

    @property
    def stage(self) -> None:
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
