"""What each law keeps with slow devices and with a fifth more or less of a parameter: the table of docs/passivity.md.

The linear laws have a delay margin from theory. All are also run in lockstep on a spring over a constant link: verdict,
least energy of two-port and device, and the force in the hold. The slave half's own loop has a greatest stiffness.
"""

from typing import NamedTuple

import pytest
from telenano_lab.studies.loops.cells import Cell, run_cell
from telenano_lab.studies.loops.theory import critical_link_delay_s, loop_model

from telenano.sections import late_periods
from telenano.wire import ConfigError

SHARES = (0.8, 1.2)


class Margin(NamedTuple):
    """One variant of a law: what was changed, and what becomes of it.

    link_ms: the round trip of the link that the linear loop bears, from theory [ms], None for a law without one;
    stiffness_n_per_m: the stiffest sample that the slave half bears, were all the latency of the devices that of the
    instrument, None without a loop of its own. Over the link that was asked for: the verdict, the least energy [J], and
    the mean force in the hold [N], None where there is no hold.
    """

    changed: str
    link_ms: float | None
    stiffness_n_per_m: float | None
    verdict: str
    lowest_energy_j: float
    hold_n: float | None


def margins(law: str, round_trip_ms: float, stiffness_n_per_m: float, latency_ms: float) -> list[Margin]:
    """Return a row for a law as it comes, with devices of a latency [ms], and for each parameter times SHARES.

    A value that is out of its range is left out, and so is a parameter that is no number or zero.
    """
    cell = Cell(
        law=law, environment="spring", round_trip_ms=round_trip_ms, stiffness_n_per_m=stiffness_n_per_m, session_s=None
    )
    values = cell.controller().law_config().model_dump()
    rows = [
        _margin("", cell),
        _margin(f"devices of {latency_ms:g} ms", cell.model_copy(update={"device_latency_ms": latency_ms})),
    ]
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not value:
            continue
        for share in SHARES:
            changed = cell.model_copy(update={"settings": ((f"{law}.{name}", share * value),)})
            try:
                rows.append(_margin(f"{name} x {share:g}", changed))
            except ConfigError:
                continue
    return rows


def _margin(changed: str, cell: Cell) -> Margin:
    controller = cell.controller()
    loop = None if controller.clamp.enabled else loop_model(cell.law, controller.law_config(), cell.stiffness_n_per_m)
    link_ms = None
    if loop is not None:
        link_ms = max(0.0, 1e3 * critical_link_delay_s(loop, controller.period_s) - cell.device_latency_ms)
    result = run_cell(cell)
    limit = controller.stiffness_limit_n_per_m(late_periods(1e-3 * cell.device_latency_ms, controller.period_s))
    return Margin(changed, link_ms, limit, result.verdict, result.lowest_energy_j, result.tip_n)


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
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/")
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
