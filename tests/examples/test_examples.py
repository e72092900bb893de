"""The programs of examples/: each is short, runs, prints its figures and draws its picture.

Those that have a rig are run by `tests/stack/test_live_examples.py`.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from documented_lines import differing
from live_examples import BESIDE_A_RIG, WITH_A_RIG

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
PROGRAMS = sorted(path.stem for path in EXAMPLES.glob("*.py"))
MOST_LINES = 60
MOST_BYTES = 80_000
ARGUMENTS = {name: ("telenano/settings/demo.mcap",) for name in ("judged", "own_analysis")}
# What a line begins with, the figure after it, and how far it may be off.
FIGURES: dict[str, tuple[tuple[str, float, float], ...]] = {
    "dask_study": (),
    "fig12": (("hand_per_tip_force", 1.05, 1e-3), ("rest_cm", 0.7035, 1e-3)),
    "fit_curves": (("force_curve.txt contact_nm 0.04 modulus_mpa", 70.38, 0.05),),
    "judged": (),
    "many_recordings": (("recordings", 100, 0), ("held_nn", 9.687, 0.01), ("spread_nn", 0.0496, 0.002)),
    "own_analysis": (("slope_n_per_m", 16.469, 0.01), ("least_force_nn", -12.482, 0.01)),
    "own_law": (("rules_broken", 0.0, 0.0),),
    "own_line": (("usual delay, q50 [ms]", 75.8, 0.2), ("lost", 0.014, 0.001)),
    "own_sample": (("held_nn", 19.048, 0.05), ("least_nn", -5.044, 0.02)),
    "thirty_conditions": (("conditions", 30, 0),),
    "why_it_rings": (("K_f 20 delay_ms 40 verdict stable margin_ms", 5.0, 0.1),),
}
# Programs that simulate many sessions or a long line.
MINUTES = ("many_recordings", "own_line", "thirty_conditions")
TEXTS: dict[str, tuple[str, ...]] = {
    "dask_study": (
        "K_f 10 delay_ms 60 verdict stable",
        "K_f 20 delay_ms 60 verdict limit_cycle",
        "K_f 40 delay_ms 20 verdict stable",
        "K_f 40 delay_ms 40 verdict limit_cycle",
    ),
    "fig12": ("verdict stable",),
    "fit_curves": (),
    "judged": ("verdict stable: at rest", "hold 2 2.90..4.50 s stable: at rest"),
    "many_recordings": (),
    "own_analysis": (),
    "own_law": ("law virtual_impedance verdict limit_cycle", "law my_law verdict stable"),
    "own_line": (
        "law virtual_impedance verdict limit_cycle, struck",
        "law wave verdict stable, parted",
        "law tdpa verdict stable, nothing_moved, off_force, struck",
    ),
    "own_sample": ("verdict stable",),
    "thirty_conditions": ("law wave 0:stable 20:stable 40:stable 60:stable", "60:limit_cycle"),
    "why_it_rings": ("K_f 20 delay_ms 60 verdict limit_cycle",),
}


def test_every_program_is_tried() -> None:
    assert sorted(FIGURES) == sorted(TEXTS)
    assert sorted([*FIGURES, *BESIDE_A_RIG, *WITH_A_RIG]) == PROGRAMS


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_is_short_has_its_picture_and_is_in_the_table(name: str) -> None:
    assert len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= MOST_LINES
    assert (EXAMPLES / f"{name}.png").stat().st_size <= MOST_BYTES
    (row,) = [
        line
        for line in (EXAMPLES / "README.md").read_text(encoding="utf-8").splitlines()
        if f"examples/{name}.py" in line
    ]
    assert f"({name}.png)" in row


@pytest.mark.check("runs a program that simulates and draws")
@pytest.mark.drawn(0.25, "examples/")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.endurance] if name in MINUTES else []) for name in FIGURES]
)
def test_a_program_prints_its_figures_and_draws_its_picture(name: str, tmp_path: Path) -> None:
    command = [sys.executable, f"examples/{name}.py", *ARGUMENTS.get(name, ()), str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    for beginning, figure, tolerance in FIGURES[name]:
        (found,) = re.findall(rf"^{re.escape(beginning)} (-?[\d.]+)", done.stdout, re.MULTILINE)
        assert abs(float(found) - figure) <= tolerance, beginning
    for text in TEXTS[name]:
        assert text in done.stdout
    assert differing(tmp_path / f"{name}.png", EXAMPLES / f"{name}.png") < 0.02
