"""What each law keeps with slow devices and with a fifth more or less of a parameter: the table of docs/laws.md."""

import pytest
from law_margins import SHARES, margins


def test_the_margins_of_the_paper_are_those_of_the_document() -> None:
    rows = {row.changed: row for row in margins("virtual_impedance", 20.0, 20.0, 15.0)}
    links = {name: row.link_ms for name, row in rows.items() if row.link_ms is not None}
    assert set(links) == set(rows)
    assert links[""] == pytest.approx(45.0, abs=0.05)
    assert links["devices of 15 ms"] == pytest.approx(30.0, abs=0.05)
    assert min((value, name) for name, value in links.items() if " x " in name) == (
        pytest.approx(34.4, abs=0.05),
        "damping_n_s_per_m x 0.8",
    )
    assert {row.verdict for row in rows.values()} == {"stable"}
    # its K_v of 0 has no fifth
    assert len(rows) == 2 + len(SHARES) * 6


@pytest.mark.check("long sessions of every variant")
def test_beyond_its_margin_a_variant_is_not_stable() -> None:
    rows = {row.changed: row for row in margins("position_force", 40.0, 20.0, 15.0)}
    assert rows[""].verdict == "stable"
    for changed in ("devices of 15 ms", "damping_n_s_per_m x 0.8"):
        link_ms = rows[changed].link_ms
        assert link_ms is not None and link_ms < 40.0
        assert rows[changed].verdict != "stable"


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.parametrize(
    ("law", "limit", "least_limit", "least_j", "hold_n"),
    [
        ("wave", 444.4, 355.6, -1e-6, 1.0),
        ("passivity", 800.2, 640.2, -1e-6, 1.0),
        ("model_mediated", 400.0, 320.0, -2.6e-4, 1.0),
        ("smith", None, None, -0.9e-4, 0.95),
    ],
)
def test_a_fifth_of_any_parameter_and_slow_devices_leave_each_law_stable(
    law: str, limit: float | None, least_limit: float | None, least_j: float, hold_n: float
) -> None:
    rows = margins(law, 120.0, 20.0, 15.0)
    assert {row.verdict for row in rows} == {"stable"}
    assert min(row.lowest_energy_j for row in rows) > least_j
    assert all(row.hold_n == pytest.approx(hold_n, abs=0.015) for row in rows)
    if limit is not None:
        # slow devices have a limit of their own, which is far lower
        prompt = [row for row in rows if row.changed != "devices of 15 ms"]
        limits = [row.stiffness_n_per_m for row in prompt if row.stiffness_n_per_m is not None]
        assert (limits[0], min(limits)) == (pytest.approx(limit, rel=1e-3), pytest.approx(least_limit, rel=2e-2))
