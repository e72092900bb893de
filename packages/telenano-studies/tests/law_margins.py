"""What a law keeps when one of its parameters is a fifth more or less, and with the latency of devices.

The linear laws have a delay margin from theory. All are also run in lockstep on a spring over a constant link: verdict,
least energy of two-port and device, and the force in the hold. The slave half's own loop has a greatest stiffness.
"""

from typing import NamedTuple

from telenano_studies.loops.cells import Cell, run_cell
from telenano_studies.loops.theory import critical_link_delay_s, loop_model

from proto.errors import ConfigError
from services.controller.config import late_periods

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
