"""The effect of delay on each law, for one slider: Nyquist curve, characteristic roots, course and energy of a session.

The courses are those of the laws' own steps in lockstep, as in `study stability`: a hand presses with 1 N on a spring
of 20 N/m. Curve and roots come from the linear theory (`linear_loop.py`), for the laws that are linear. The data and
the code that draws them are in `services/viz_node/web/gallery`, so that the page of `telenano view` shows the same.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from telenano.serving import web_folder
from telenano_lab.studies.loops.cells import Cell, energies_of, judged, scales_of, trajectory_of
from telenano_lab.studies.loops.linear_cells import linear_loop, not_linear
from telenano_lab.studies.option_values import COMPARED_LAWS

STIFFNESS_N_PER_M = 20.0
DELAYS_MS = tuple(5.0 * i for i in range(41))
# The length of the courses from the session's first sample [s].
_LENGTH_S = 3.0
# The intervals at which force and energy are sampled.
_FORCE_STEP_S = 0.01
_ENERGY_STEP_S = 0.02
# The unit of forces in the file.
_FORCE_N = 1e-3
# The greatest force in the picture.
_MOST_N = 6.0
# The unit of energies in the file.
_ENERGY_J = 1e-6
# The greatest energy in the picture.
_MOST_J = 0.02
# The unit of points of the Nyquist curve in the file.
_CURVE = 1e-2
# The greatest magnitude of the Nyquist curve in the picture.
_MOST_CURVE = 9.0
# The frequencies at which the Nyquist curve is computed.
_FREQUENCIES_HZ = np.geomspace(0.2, 40.0, 150)

FOLDER = web_folder() / "gallery"


def cell_of(law: str, round_trip_ms: float, stiffness_n_per_m: float = STIFFNESS_N_PER_M) -> Cell:
    """Return the cell of a law at a round trip [ms] on a spring [N/m]."""
    return Cell(law=law, environment="spring", stiffness_n_per_m=stiffness_n_per_m, round_trip_ms=round_trip_ms)


def shown(cell: Cell) -> dict[str, Any]:
    """Return the data that are drawn of a cell; a series has the difference of each number from the one before."""
    course, scales = trajectory_of(cell), scales_of(cell.controller())
    hold = judged(cell, course)
    force = scales.force_scale * course.tip_force_n
    drawn = {
        "verdict": hold.verdict,
        "reason": hold.reason,
        "lowest_mj": round(1e3 * hold.lowest_energy_j, 3),
        "force": _kept(_every(course.time_s, force, _FORCE_STEP_S), _FORCE_N, _MOST_N),
        "energy": _kept(
            _every(course.time_s, energies_of(course, scales).stored_j, _ENERGY_STEP_S), _ENERGY_J, _MOST_J
        ),
    }
    if not not_linear(cell):
        loop = linear_loop(cell)
        curve = loop.response(2.0 * np.pi * _FREQUENCIES_HZ)
        # Points that are far away keep their direction.
        curve = curve * np.minimum(1.0, _MOST_CURVE / np.abs(curve))
        drawn["nyquist"] = [_kept(curve.real, _CURVE, _MOST_CURVE), _kept(curve.imag, _CURVE, _MOST_CURVE)]
        drawn["roots"] = [[round(root.real, 4), round(root.imag, 4)] for root in loop.roots().tolist()]
    return drawn


def gallery(
    stiffness_n_per_m: float = STIFFNESS_N_PER_M, progress: Callable[[int, int], None] = lambda n, of: None
) -> dict[str, Any]:
    """Return the document for the gallery: conditions, units, and each law at each delay on a spring [N/m]."""
    laws, total = [], len(COMPARED_LAWS) * len(DELAYS_MS)
    for number, law in enumerate(COMPARED_LAWS):
        first, cells = cell_of(law, 0.0, stiffness_n_per_m), []
        for place, delay_ms in enumerate(DELAYS_MS):
            cells.append(shown(cell_of(law, delay_ms, stiffness_n_per_m)))
            progress(number * len(DELAYS_MS) + place + 1, total)
        critical_ms = None if not_linear(first) else 1e3 * linear_loop(first).critical_link_delay_s
        laws.append({
            "law": law,
            "linear": not not_linear(first),
            "critical_ms": critical_ms if critical_ms is not None and np.isfinite(critical_ms) else None,
            "cells": cells,
        })  # fmt: skip
    return {
        "stiffness_n_per_m": stiffness_n_per_m,
        "delays_ms": list(DELAYS_MS),
        "hand": [list(point) for point in first.hand_points()],
        "force": {"step_s": _FORCE_STEP_S, "unit": _FORCE_N},
        "energy": {"step_s": _ENERGY_STEP_S, "unit": 1e3 * _ENERGY_J},
        "nyquist": {"unit": _CURVE},
        "laws": laws,
    }


def fragment_of(document: dict[str, Any]) -> str:
    """Return the gallery as a part of a page, including its style, its data and its code."""
    style, code = ((FOLDER / name).read_text(encoding="utf-8") for name in ("gallery.css", "gallery.js"))
    # No data may contain the end tag of the script.
    data = json.dumps(document, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<style>{style}</style>\n<div id="delay-gallery"></div>\n'
        f'<script type="application/json" id="delay-gallery-data">{data}</script>\n'
        f'<script type="module">{code}\n'
        'new Gallery(document.getElementById("delay-gallery"), '
        'JSON.parse(document.getElementById("delay-gallery-data").textContent));</script>\n'
    )


def page_of(document: dict[str, Any]) -> str:
    """Return the gallery as one self-contained HTML file."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width"><title>What a delay does</title></head>\n'
        f'<body class="gallery-page"><main><h1>What a delay does</h1>\n{fragment_of(document)}</main></body></html>\n'
    )


def write_data(document: dict[str, Any], path: Path) -> None:
    """Write the document with one line for each law and delay."""
    head = json.dumps({key: value for key, value in document.items() if key != "laws"})[:-1]
    rows = []
    for law in document["laws"]:
        about = json.dumps({key: value for key, value in law.items() if key != "cells"})[:-1]
        cells = ",\n".join(json.dumps(cell, separators=(",", ":")) for cell in law["cells"])
        rows.append(f'{about}, "cells": [\n{cells}\n]}}')
    laws = ",\n".join(rows)
    path.write_text(f'{head}, "laws": [\n{laws}\n]}}\n', encoding="utf-8")


def _every(time_s: Any, values: Any, step_s: float) -> Any:
    at = np.arange(0.0, _LENGTH_S, step_s)
    # A session that a guard ended early is shorter; its last value is repeated.
    return values[np.minimum(np.searchsorted(time_s, at), len(values) - 1)]


def _kept(values: Any, unit: float, most: float) -> list[int]:
    """Return values in whole units, each as the difference from the one before."""
    whole = np.rint(np.clip(values, -most, most) / unit).astype(int)
    return [int(one) for one in np.diff(whole, prepend=0)]
