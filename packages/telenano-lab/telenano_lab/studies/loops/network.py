"""Run each law in lockstep over a measured network, with the recorded delays and losses."""

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from telenano.settings import LinkSettings
from telenano.wire import ConfigError
from telenano_lab.studies.loops.cells import Cell, CellResult, course_of, run_cell
from telenano_lab.studies.loops.tuning import tuned

# k of the cantilever of Table 2, in the contact of Fig. 12 [N/m].
CONTACT_N_PER_M = 40.0


@dataclass(frozen=True)
class MeasuredNetwork:
    """The link settings that replay a measurement, the folder of its files, and its figures over both directions."""

    settings: LinkSettings
    folder: Path
    round_trip_ms: float
    lost_share: float


def measured_network(folder: Path) -> MeasuredNetwork:
    """Return the network in a folder of `telenano link probe`.

    Raises:
        ConfigError: The folder has no complete probe.
    """
    file = folder / "probe.json"
    try:
        probe = json.loads(file.read_text(encoding="utf-8"))
        ways = probe["network"].values()
        round_trip_ms = sum(way["delay_p50_ms"] for way in ways)
        lost_share = max(way["lost_share"] for way in ways)
        replay = probe["replay"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{file}: is not a result of `telenano link probe`: {error}; of a log of a line `telenano link fit` makes a"
            " network, which `study advise --network` takes"
        ) from error
    return MeasuredNetwork(LinkSettings.of(replay), folder, round_trip_ms, lost_share)


def run_laws(laws: Sequence[str], network: MeasuredNetwork) -> list[tuple[bool, CellResult]]:
    """Run each law in the contact of Fig. 12, with its defaults (False) and tuned for the round trip (True)."""
    rows = []
    for law in laws:
        for is_tuned in (False, True):
            cell = Cell(
                law=law,
                environment="tip_sample",
                round_trip_ms=network.round_trip_ms,
                stiffness_n_per_m=CONTACT_N_PER_M,
                loss=network.lost_share,
            )
            if is_tuned:
                settings = tuned(law, CONTACT_N_PER_M, cell.round_trip_s)
                cell = cell.model_copy(update={"settings": settings})
            measured = (network.settings, network.folder)
            course = functools.partial(course_of, cell, cell.hand_points(), cell.hold_s()[1], measured)
            rows.append((is_tuned, run_cell(cell, course)))
    return rows


def rows_of(results: Sequence[tuple[bool, CellResult]]) -> list[dict[str, Any]]:
    """Return the verdicts as rows of a table."""
    return [
        {
            "law": result.cell.law,
            "parameters": "tuned" if is_tuned else "defaults",
            "verdict": result.verdict,
            "hold_ratio": None if result.hold_ratio is None else round(result.hold_ratio, 4),
            "reason": result.reason,
        }
        for is_tuned, result in results
    ]
