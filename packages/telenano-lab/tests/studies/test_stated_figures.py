"""The figures that docs/studies.md and docs/study-results.md state are those that the studies give."""

import re
from pathlib import Path
from typing import Any

import pytest
from telenano_lab.studies.loops.advice import Question, cells_of
from telenano_lab.studies.loops.cells import Cell, run_cell
from telenano_lab.studies.loops.theory import critical_delay_s, loop_model
from telenano_lab.studies.loops.tuning import tuned
from telenano_lab.studies.option_values import COMPARED_LAWS, Jitter

from telenano.sections import LAWS

# the networks of the page: constant, with a little loss, and bad
NETWORKS: tuple[dict[str, Any], ...] = ({}, {"loss": 0.03}, {"loss": 0.2, "jitter": Jitter(0.5, True)})
DOCS = Path(__file__).resolve().parents[2] / "docs"
STUDIES = "".join((DOCS / page).read_text(encoding="utf-8") for page in ("studies.md", "study-results.md"))
NAMES = {
    "virtual impedance": "virtual_impedance",
    "position–force": "position_force",
    "model-mediated": "model_mediated",
}


def rows_of(heading: str) -> list[list[str]]:
    """Return the cells of the table whose head begins with a text."""
    lines = STUDIES[STUDIES.index(f"| {heading}") :].partition("\n\n")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def law_of(cell: str) -> str:
    name = cell.partition(",")[0].lower()
    return NAMES.get(name, name)


def test_the_critical_delays_of_theory_are_those_of_the_page() -> None:
    rows = {law_of(row[0]): row[1] for row in rows_of("critical round trip, ms")}
    for law in ("virtual_impedance", "position_force"):
        stated = [float(text) for text in rows[law].split("/")]
        models = [loop_model(law, LAWS[law].config(), stiffness) for stiffness in (10.0, 20.0, 38.0)]
        found = [1e3 * critical_delay_s(model) for model in models if model is not None]
        assert stated == [round(delay_ms, 2) for delay_ms in found]
    # the others close no linear loop through the link
    assert all(loop_model(law, LAWS[law].config(), 38.0) is None for law in COMPARED_LAWS if not rows.get(law))


@pytest.mark.endurance
@pytest.mark.stack
@pytest.mark.parametrize(
    ("law", "clamp", "environment", "delays_ms", "networks", "least"),
    [
        ("model_mediated", True, "wall", (50.0, 120.0, 250.0), NETWORKS, 0.95),
        ("model_mediated", True, "tip_sample", (50.0, 120.0, 250.0), NETWORKS, 0.95),
        ("smith", True, "tip_sample", (50.0, 120.0), NETWORKS, 0.94),
        ("position_force", False, "wall", (50.0, 120.0, 250.0), NETWORKS[:2], 0.99),
    ],
)
def test_laws_that_the_page_recommends_hold_over_its_networks(
    law: str, clamp: bool, environment: str, delays_ms: tuple[float, ...], networks: Any, least: float
) -> None:
    for delay_ms in delays_ms:
        for network in networks:
            question = Question(
                round_trip_ms=delay_ms,
                environment=environment,
                stiffness_n_per_m=40.0 if environment == "tip_sample" else 80.0,
                **network,
            )
            level_n = 2.0 if environment == "tip_sample" else 1.0
            for result in map(run_cell, cells_of(question, law, clamp)):
                assert result.verdict == "stable", (delay_ms, network, result.reason)
                if result.cell.hand == "force":
                    assert result.tip_n is not None and result.tip_n / level_n >= least


@pytest.mark.endurance
@pytest.mark.stack
@pytest.mark.parametrize("law", ["wave", "passivity", "model_mediated"])
def test_laws_without_a_critical_delay_hold_the_springs_up_to_half_a_second(law: str) -> None:
    for stiffness in (10.0, 20.0, 38.0):
        for delay_ms in (50.0, 100.0, 200.0, 350.0, 500.0):
            assert verdict_on_a_spring(law, stiffness, delay_ms) == "stable", (stiffness, delay_ms)


def verdict_on_a_spring(law: str, stiffness_n_per_m: float, delay_ms: float) -> str:
    cell = Cell(law=law, environment="spring", round_trip_ms=delay_ms, stiffness_n_per_m=stiffness_n_per_m)
    return run_cell(cell).verdict


@pytest.mark.check("compiles a law")
def test_a_smith_predictor_strikes_the_springs_from_the_delays_of_the_page_on() -> None:
    stated = re.search(r"from ([\d /]+)", dict((law_of(row[0]), row[2]) for row in rows_of("critical round"))["smith"])
    assert stated is not None
    for stiffness, text in zip((10.0, 20.0, 38.0), stated[1].split("/"), strict=True):
        delays_ms = (50.0, float(text) - 1.0, float(text), 500.0)
        spring: dict[str, Any] = {"law": "smith", "environment": "spring", "stiffness_n_per_m": stiffness}
        results = [run_cell(Cell(**spring, round_trip_ms=delay_ms)) for delay_ms in delays_ms]
        assert {result.verdict for result in results} == {"stable"}
        assert ["struck" in result.facts for result in results] == [False, False, True, True]


def test_the_price_of_the_damping_is_that_of_the_document() -> None:
    stated = re.search(r"at\s120\sms\sfree\smotion\sis\s(\d+)\sto\s(\d+)\stimes\sas\sheavy", STUDIES)
    assert stated is not None
    light = LAWS["wave"].config().damping_n_s_per_m  # type: ignore[attr-defined]
    ratios = []
    for law in ("position_force", "virtual_impedance"):
        gain = getattr(LAWS[law].config(), "force_gain", 1.0)
        ratios.append(float(dict(tuned(law, 80.0, 0.12))[f"{law}.damping_n_s_per_m"]) / gain / light)
    assert [round(ratio) for ratio in sorted(ratios)] == [int(number) for number in stated.groups()]
