"""A point of the frontier is the median of what was held, over the networks that it is drawn for."""

from pathlib import Path

import pytest
from telenano_laws.frontier import frontier, points_of


def run(law: str, network: str, verdict: str, tracking: str, stiffness: str, least_mj: str) -> dict[str, str]:
    measures = {"tracking_error": tracking, "stiffness_ratio": stiffness, "least_energy_mj": least_mj}
    return {"law": law, "network": network, "verdict": verdict, **measures}


ROWS = [
    run("soft", "clean", "stable", "0.6", "0.3", "0.0"),
    run("soft", "clean", "stable", "0.8", "0.5", "0.0"),
    run("soft", "clean", "stable", "", "", "-0.1"),
    run("soft", "satellite", "stable", "0.9", "0.2", "0.0"),
    run("wild", "clean", "diverged", "0.1", "1.0", "-40"),
    run("wild", "satellite", "diverged", "", "", "-90"),
]


def test_points_have_the_medians_of_what_was_held_and_the_least_of_all() -> None:
    soft, wild = points_of(ROWS, over_long=False)
    assert (soft.tracking, soft.stiffness, soft.least_mj, soft.held) == pytest.approx((0.7, 0.4, -0.1, 1.0))
    assert (wild.tracking, wild.least_mj, wild.held) == (None, -40.0, 0.0)
    assert points_of(ROWS, over_long=True)[0].tracking == 0.9


def test_the_picture_is_drawn_also_where_a_law_held_nothing(tmp_path: Path) -> None:
    frontier(ROWS).savefig(tmp_path / "frontier.png")
    assert (tmp_path / "frontier.png").stat().st_size > 10_000
