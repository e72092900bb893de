"""Fig. 10 and 12 of the paper from a running rig: run the scenario of each, and read its recording."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.cli import run_session
from telenano.recording import Recording
from telenano.sections import AfmConfig
from telenano.settings import LoadedScenario, find_scenario
from telenano.wire import RigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

RECORDING_NAME = "session.mcap"
# The longest time for the processes to start and end, beyond the session [s].
_OVERHEAD_S = 120.0
# Their usual time [s].
_USUAL_OVERHEAD_S = 8.0


class TactilePath(NamedTuple):
    """Fig. 10: place on the line [m], height of the hand [m], surface as the tip sees it [m], time [s], alpha_p."""

    way_m: Array
    hand_m: Array
    surface_m: Array
    time_s: Array
    position_scale: float

    @property
    def correlation(self) -> float:
        return float(np.corrcoef(self.hand_m, self.surface_m)[0, 1])

    @property
    def rms_m(self) -> float:
        """The RMS difference of the hand and the scaled surface, at the hand's scale [m]."""
        return float(np.sqrt(np.mean((self.hand_m - self.surface_m / self.position_scale) ** 2)))


def run_scenario(name: str, out: Path, progress: Callable[[int, int], object] = lambda n, of: None) -> Path:
    """Run a scenario of the project on real processes and return its recording.

    Args:
        name: The name of the scenario.
        out: The folder of the recording.
        progress: Called with the seconds so far and the usual total.

    Raises:
        RigError: The rig did not run; the message says why.
    """
    folder = (out / name).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "telenano", "up", "--scenario", name, "--out", str(folder)]
    command += ["--overwrite", "--headless", "--json", "--no-view"]
    duration_s = LoadedScenario.load(find_scenario(name)).scenario.duration_s
    usual = round(duration_s + _USUAL_OVERHEAD_S)
    try:
        # Missing data in the recording are visible in the figure.
        run_session(command, duration_s + _OVERHEAD_S, lambda spent_s: progress(min(round(spent_s), usual), usual))
    except TimeoutError as error:
        raise RigError(f"{name}: {error}, see {folder}") from error
    except RigError as error:
        raise RigError(f"{name}: the rig did not run: {error}") from error
    if not (folder / RECORDING_NAME).exists():
        raise RigError(f"{name}: the rig has left no recording in {folder}")
    progress(usual, usual)
    return folder / RECORDING_NAME


def tactile_path(recording_file: Path) -> TactilePath:
    """Return the path that the hand felt, from the first touch to the end of the line.

    Raises:
        RigError: The tip never went along a line in contact.
    """
    recording = Recording(recording_file)
    loaded = LoadedScenario.load(find_scenario("fig10"))
    config = loaded.section("afm_node", AfmConfig)
    controller: dict[str, Any] = loaded.scenario.controller
    tip = recording.columns("afm/state", ("t_ns", "base_position_m.0", "base_position_m.1", "in_contact", "mode"))
    hand = recording.columns("haptic/state", ("t_ns", "position_m.2"))
    x, y = tip["base_position_m.0"].astype(float), tip["base_position_m.1"].astype(float)
    assert config.begin is not None
    path = config.begin.settings_of("tactile")
    way = np.hypot(x - path.x0_m, y - path.y0_m)
    felt = np.flatnonzero((tip["in_contact"].astype(bool)) & (tip["mode"] == "follow") & (way > 0.0))
    if len(felt) < 100:
        raise RigError(f"{recording_file}: the tip did not go along a line in contact")
    surface = config.to_surface()
    assert surface is not None
    columns_at = np.clip(((x[felt] + 0.5 * surface.width_m) / surface.step_x_m).astype(int), 0, None)
    rows_at = np.clip(((y[felt] + 0.5 * surface.depth_m) / surface.step_y_m).astype(int), 0, None)
    heights = surface.height_m[
        np.minimum(rows_at, surface.height_m.shape[0] - 1), np.minimum(columns_at, surface.height_m.shape[1] - 1)
    ]
    time_ns = tip["t_ns"][felt].astype(np.int64)
    hand_m = np.interp(time_ns, hand["t_ns"].astype(np.int64), hand["position_m.2"].astype(float))
    # Heights are relative to the beginning of the path.
    return TactilePath(
        way[felt],
        hand_m - hand_m[0],
        heights - heights[0],
        (time_ns - time_ns[0]) * 1e-9,
        float(controller["tactile"]["position_scale"]),
    )


def tactile_figure(path: TactilePath) -> "Figure":
    """Draw Fig. 10: x_m of the hand solid, the surface at the hand's scale dashed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.plot(path.way_m * 1e9, path.hand_m * 1e2, color="#1f4e79", label="hand x_m")
    scaled = path.surface_m / path.position_scale * 1e2
    axes.plot(path.way_m * 1e9, scaled, "--", color="#c0392b", label="surface as the tip sees it, at 0.1 cm/nm")
    axes.set_xlabel("way along the line [nm]")
    axes.set_ylabel("height at the hand [cm]")
    axes.legend(loc="upper center")
    axes.grid(alpha=0.3)
    return figure
