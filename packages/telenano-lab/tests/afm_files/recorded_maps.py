"""Recorded maps with a known answer, as the tests write them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from telenano_lab.afm_files import recorded_map
from telenano_lab.afm_files.recorded_map import MapState
from telenano_lab.doubles.maker_files import STIFFNESS_N_PER_M, adhesive

from telenano.devices import driver_of
from telenano.extend.samples import PlantInputs
from telenano.sections import AfmConfig
from telenano.testing import afm_node

Array = npt.NDArray[np.float64]


def force_n(z_m: Any, x_m: Any, y_m: Any) -> Any:
    """Return the force of a smooth wall of height 2 nm above the bottom, whose range changes with x and y [N]."""
    reach = 1e-9 * (1.0 + 0.2 * np.sin(2e7 * x_m) * np.cos(1.5e7 * y_m))
    return 4e-9 * np.exp(-z_m / reach)


def members(**changes: Any) -> dict[str, Any]:
    """Return the members of a map of 5 x 4 x 41 points over 100 x 60 nm and 20 nm."""
    x, y, z = np.linspace(-50e-9, 50e-9, 5), np.linspace(-30e-9, 30e-9, 4), np.linspace(0.0, 20e-9, 41)
    value = force_n(z[None, None, :], x[:, None, None], y[None, :, None])
    made = {
        "value": value, "x": x, "y": y, "z": z, "unit": "N", "length_unit": "m", "sign": 1, "axis": "base",
        "stiffness_n_per_m": STIFFNESS_N_PER_M, "source": "made",
    }  # fmt: skip
    return {key: value for key, value in {**made, **changes}.items() if value is not None}


def hysteretic(**changes: Any) -> dict[str, Any]:
    """Return the members of one curve with both branches, 0.1 nm apart."""
    z = np.linspace(0.0, 20e-9, 201)
    both = np.stack(adhesive(z), axis=1)[None, None]
    return members(value=both, x=np.zeros(1), y=np.zeros(1), z=z, **changes)


def write_npz(path: Path, made: dict[str, Any]) -> Path:
    np.savez(path, **made)
    return path


def frequency_shift_hz(z_m: Any) -> Any:
    """Return a frequency shift with its minimum of -8 Hz at 0.4 nm [Hz]."""
    u = np.asarray(z_m) / 0.4e-9
    return -8.0 * u * np.exp(1.0 - u)


def near(force: float, expected: float, error_n: float) -> bool:
    return math.isfinite(force) and abs(force - expected) <= error_n


def forces(params: recorded_map.MapParams, heights: Any, x_m: float = 0.0, y_m: float = 0.0) -> list[float]:
    """Return the force at heights above the bottom, which the base goes through one after the other [N]."""
    state, felt = MapState(math.inf, 0.0, False, 0.0), []
    for z_m in heights:
        inputs = PlantInputs(params.rest_distance_m - z_m, x_m, y_m)
        state, sample = recorded_map.step(params, state, inputs, 1e-3)
        felt.append(sample.force_n)
    return felt


def config_of(path: Path, **changes: Any) -> AfmConfig:
    return AfmConfig.model_validate({"sample": {"map": str(path)}, "rest_distance_m": 20e-9, **changes})


class Rig:
    """An AFM over a recorded map on a bench."""

    def __init__(self, bench: Any, config: AfmConfig) -> None:
        self.bench, self.node = bench, afm_node(bench, driver_of(config), config)

    def go(self, x_s_m: float, steps: int = 1, x_m: float = 0.0, y_m: float = 0.0) -> Any:
        """Command a base and a place a millisecond apart; return the last state."""
        for _ in range(steps):
            self.bench.advance_ms(1.0)
            fields = {"mode": "position", "base_position_m": (x_m, y_m, -x_s_m), "hand_seq": 1, "hand_armed": True}
            sent = self.bench.received("afm/command", "controller@slave", **fields, hand_t_ns=self.bench.clock.now_ns())
            self.node.on_message(sent)
        return self.bench.take("afm/state")[-1]

    def control(self, command: str, **parameters: Any) -> str:
        fields = {"id": "a", "command": command, "target": "afm_node", "parameters": parameters}
        return self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def said(self) -> list[str]:
        return [event.text for event in self.bench.take("session/event")]
