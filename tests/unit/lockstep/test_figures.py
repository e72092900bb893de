"""No figure has text cut off, a legend or a label over another, or two ticks that read the same."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from figure_layout import faults
from matplotlib.figure import Figure
from telenano_lab.experiments.benchmark import results
from telenano_lab.experiments.benchmark_page import benchmark_figure
from telenano_lab.networks.network_trace import NetworkTrace, trace_figure
from telenano_lab.studies.loops.push_study import Row
from telenano_lab.studies.pages.stability_page import _edges, _up_to
from telenano_lab.studies.push_command import push_figure
from tried_laws import TRIED_LAWS as ALL_LAWS
from typer.testing import CliRunner

from telenano.cli.root import app


def test_a_fault_in_a_layout_is_found() -> None:
    """The check fails for what it is there to find."""
    figure = Figure(figsize=(2.0, 1.5))
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0], label="a name that is far too long for so narrow a figure")
    axes.set_yticks([0.0, 0.5, 0.5004], ["0", "0.5", "0.5"])
    axes.set_title("a title that is far too long for so narrow a figure as this one is")
    figure.legend(loc="upper center")
    found = faults(figure)
    assert any("is cut off" in fault and "title" in fault for fault in found)
    assert any("the legend" in fault and "cut off" in fault for fault in found)
    assert any("lies over" in fault for fault in found)
    assert "two ticks read '0.5'" in found


@pytest.mark.parametrize(("edge_ms", "third"), [(45.0, 45.0), (None, 50.0), (80.0, 50.0)])
def test_the_colours_of_a_map_change_at_the_edge_that_was_found(edge_ms: float | None, third: float) -> None:
    delays = np.array([0.0, 20.0, 40.0, 60.0])
    line: Any = SimpleNamespace(critical_link_ms=edge_ms)
    assert _up_to(line, delays, _edges(delays)).tolist() == [0.0, 10.0, 30.0, third, 60.0]


def of_the_benchmark() -> Figure:
    spread: dict[str, Any] = {"tracking_error": results.Spread(0.0123, 0.01, 0.02)}
    networks = ("clean", "transcontinental", "leo_satellite", "lossy_bursts")
    rows = [
        results.Row(
            case=results.Case("ideal", "scripted", network),
            law=law,
            runs=24,
            held=24 - 4 * number,
            low=0.5,
            high=1.0,
            made_energy=0,
            sound=24 - 4 * number,
            verdicts={"stable": 24 - 4 * number, "diverged": 4 * number},
            measures=spread,
        )
        for network in networks
        for number, law in enumerate(ALL_LAWS)
    ]
    return benchmark_figure(rows)


def of_pushes() -> Figure:
    rows = [
        Row(
            law=law,
            round_trip_ms=trip_ms,
            loss=loss,
            trials=50,
            placed=48,
            low=0.86,
            high=0.99,
            time_s=4.0 + 1e-3 * trip_ms,
            error_nm=12.0,
            losses=0.1,
            peak_nn=30.0,
            press_nn=25.0,
        )
        for law in ALL_LAWS
        for trip_ms in (0.0, 100.0, 500.0)
        for loss in (0.0, 0.05)
    ]
    return push_figure(rows)


def of_a_network() -> Figure:
    delay_s = 0.02 + 0.005 * np.random.default_rng(1).random(500)
    lost = np.random.default_rng(2).random(500) < 0.02
    return trace_figure(
        {
            "forward": NetworkTrace("forward", 1e-3 * np.arange(500.0), delay_s, lost, 0, 1e-3),
            "backward": NetworkTrace("backward", 1e-3 * np.arange(500.0), delay_s, lost, 0, 1e-3),
        }
    )


@pytest.mark.check("draws figures, half a second each")
@pytest.mark.parametrize("draw", [of_the_benchmark, of_pushes, of_a_network])
def test_other_figures_are_whole(draw: Callable[[], Figure]) -> None:
    assert faults(draw()) == []


# commands with small runs, each with the figures that it draws
COMMANDS = {
    "study stability --law virtual_impedance,wave --environment spring --stiffness 10,20 --delay 0:80:20"
    " --workers 1": 4,
    "study transparency --law virtual_impedance,wave,passivity --delay 0,60": 3,
    "report RECORDING": 1,
    "report RECORDING --style paper": 1,
    "compare RECORDING OTHER": 1,
    "compare RECORDING OTHER --style paper --paper": 1,
    "bag plot RECORDING afm/state.tip_force_n.2 haptic/state.position_m.2": 1,
    "scan --pixels 16 --lines 16": 1,
    "scan --pixels 16 --lines 16 --mode contact": 1,
    "sample --sample grating": 1,
    "curve --points 200": 1,
}


@pytest.mark.endurance
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("line", COMMANDS)
def test_no_figure_of_a_command_is_cut_off(
    line: str, recording_of: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: dict[str, list[str]] = {}
    save = Figure.savefig

    def checked(figure: Figure, *arguments: Any, **options: Any) -> None:
        save(figure, *arguments, **options)
        found[f"figure {len(found) + 1}"] = faults(figure)

    monkeypatch.setattr(Figure, "savefig", checked)
    names = {"RECORDING": "wave", "OTHER": "position_force"}
    words = [str(recording_of(names[word])) if word in names else word for word in line.split()]
    out = tmp_path / ("plot.png" if line.startswith("bag plot") else "out")
    done = CliRunner().invoke(app, [*words, "--out", str(out)])
    assert done.exit_code in (0, 3), done.output
    assert len(found) >= COMMANDS[line]
    assert {name: wrong for name, wrong in found.items() if wrong} == {}
