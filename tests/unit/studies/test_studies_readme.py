"""The figures that the README states of studies are those that the studies give, read from its own tables."""

import math
import re
from pathlib import Path

import pytest

from services.controller.config import LAWS
from studies.cells import CellResult
from studies.merits import Network, Sample, Trial
from studies.stability import Jitter
from studies.sweep import Journal, Sweep
from studies.theory import critical_delay_s, loop_model
from studies.tuning import tuned

README = (Path(__file__).resolve().parents[3] / "README.md").read_text(encoding="utf-8")
# what the table calls a run that is not stable
WORDS = {
    "drifts": "drifting", "ripples": "limit_cycle", "cycles": "limit_cycle", "wrong": "wrong_force",
    "lost": "contact_lost", "diverged": "diverged",
}  # fmt: skip
NAMES = {
    "virtual impedance": "virtual_impedance",
    "position–force": "position_force",
    "model-mediated": "model_mediated",
}


def rows_of(heading: str) -> list[list[str]]:
    """Return the cells of the table whose head begins with a text."""
    lines = README[README.index(f"| {heading}") :].partition("\n\n")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def law_of(cell: str) -> str:
    name = cell.partition(",")[0].lower()
    return NAMES.get(name, name)


def test_the_critical_delays_of_theory_are_those_of_the_readme() -> None:
    rows = {law_of(row[0]): row[1] for row in rows_of("critical round trip, ms")}
    for law in ("virtual_impedance", "position_force"):
        stated = [float(text) for text in rows[law].split("/")]
        models = [loop_model(law, LAWS[law].config(), stiffness) for stiffness in (10.0, 20.0, 38.0)]
        found = [1e3 * critical_delay_s(model) for model in models if model is not None]
        assert stated == [round(delay_ms, 2) for delay_ms in found]
    # the others close no linear loop through the link
    assert all(loop_model(law, LAWS[law].config(), 38.0) is None for law in LAWS if law not in rows)


def test_the_price_of_the_damping_is_that_of_the_readme() -> None:
    stated = re.search(r"at 120 ms free motion is (\d+) to (\d+) times as heavy", README)
    assert stated is not None
    light = LAWS["wave"].config().damping_n_s_per_m  # type: ignore[attr-defined]
    ratios = []
    for law in ("position_force", "virtual_impedance"):
        gain = getattr(LAWS[law].config(), "force_gain", 1.0)
        ratios.append(float(dict(tuned(law, 80.0, 0.12))[f"{law}.damping_n_s_per_m"]) / gain / light)
    assert [round(ratio) for ratio in sorted(ratios)] == [int(number) for number in stated.groups()]


Runs = dict[tuple[str, float, str, bool], dict[bool, list[CellResult]]]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    """The runs of the wall, as `study compare` makes them: by law, delay, hand and whether the link is bad."""
    networks = (*map(Network, (50.0, 120.0, 250.0)), Network(120.0, Jitter(0.5, relative=True), 0.2))
    sample = Sample("wall", 80.0)
    trial = Trial(tuple(LAWS), networks, ("force", "ordinary"), (sample,), 0, 3)
    keys = [
        (law, clamp, network, hand)
        for law in LAWS
        for clamp in (False, True)
        for network in networks
        for hand in trial.hands
        if not (network.random and hand == "force")
    ]
    cells = [trial.cells(sample, *key) for key in keys]
    sweep = Sweep(Journal(tmp_path_factory.mktemp("runs") / "journal.jsonl"), workers=2)
    results = iter(sweep.run([cell for some in cells for cell in some]))
    found: Runs = {}
    for (law, clamp, network, hand), some in zip(keys, cells, strict=True):
        column = found.setdefault((law, network.round_trip_ms, hand, network.random), {})
        column[clamp] = [next(results) for _ in some]
    return found


COLUMNS = (
    (50.0, "force", False), (120.0, "force", False), (250.0, "force", False),
    (50.0, "ordinary", False), (120.0, "ordinary", False), (250.0, "ordinary", False), (120.0, "ordinary", True),
)  # fmt: skip


@pytest.mark.endurance
# the first one makes all runs
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("row", rows_of("stiff wall"), ids=lambda row: law_of(row[0]))
def test_the_wall_of_the_readme_is_that_of_the_comparison(row: list[str], runs: Runs) -> None:
    wrong = []
    law = law_of(row[0])
    for column, cell in zip(COLUMNS, row[1:8], strict=True):
        for clamp, stated in zip((False, True), cell.split("/"), strict=True):
            results = runs[law, *column][clamp]
            unstable = [result.verdict for result in results if result.verdict != "stable"]
            shares = [result.tip_n or 0.0 for result in results]
            worst = max(shares, key=lambda share: abs(share - 1.0))
            as_stated = (
                WORDS[stated.strip()] in unstable
                if stated.strip() in WORDS
                else not unstable and math.isclose(worst, float(stated), rel_tol=0.0, abs_tol=0.0051)
            )
            if not as_stated:
                wrong.append((column, clamp, stated, unstable, shares))
    for clamp, stated in zip((False, True), row[8].split("/"), strict=True):
        peak_n = max(result.peak_n for result in runs[law, 120.0, "force", False][clamp])
        if not math.isclose(peak_n, float(stated), rel_tol=6e-3, abs_tol=0.0):
            wrong.append(("greatest", clamp, stated, peak_n))
    assert not wrong
