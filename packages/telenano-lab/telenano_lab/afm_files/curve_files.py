"""Read the force curves of instruments in any supported format; called in a child process with limits."""

import tempfile
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano_lab.afm_files import bruker, igor_waves, map_libraries, nanonis, nanosurf, text_curves
from telenano_lab.afm_files.recorded import Array, Curves, RecordedCurve, Way, constants_of, factor_to_force

# At most this number of points of a segment is kept; a finer curve is interpolated.
MOST_POINTS = 4096
_MOST_CURVES = 1 << 18
# Number of curves of a large map from which the sensitivity is found.
_MOST_OF_HARD = 64

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]

# afmformats reads all other formats.
_READERS: dict[str, Callable[[str], Curves]] = {
    ".dat": nanonis.curves_of,
    ".ibw": igor_waves.curves_of,
    ".nhf": nanosurf.curves_of_nhf,
    ".nid": nanosurf.curves_of_nid,
}


@contextmanager
def _open(path: str, constants: dict[str, float], options: text_curves.TableOptions = text_curves.NOTHING) -> Any:
    suffix = Path(path).suffix.lower()
    if any(options):
        if suffix not in text_curves.SUFFIXES or nanonis.is_spectroscopy(path):
            raise ValueError(f"--set {', '.join(options._fields)}: are for a text table; this file states them itself")
        yield text_curves.curves_of(path, options)
        return
    own = igor_waves.curves_of_folder if Path(path).is_dir() else _READERS.get(suffix)
    if own is None and not suffix.startswith(map_libraries.SUFFIXES):
        # Names of NanoScope files end with numbers as well.
        own = bruker.curves_of
    with tempfile.TemporaryDirectory() as folder:
        if suffix in text_curves.SUFFIXES and (own is None or not nanonis.is_spectroscopy(path)):
            try:
                if text_curves.is_of_other_columns(path):
                    raise map_libraries.NoCurvesError
                # The text formats of makers have headers of their own.
                yield (
                    map_libraries.curves_of(path, Path(folder), constants)
                    if own is None
                    else text_curves.curves_of(path)
                )
            except map_libraries.NoCurvesError:
                yield text_curves.curves_of(path)
        else:
            yield own(path) if own else map_libraries.curves_of(path, Path(folder), constants)


def _given(stiffness: str | None, sensitivity: str | None) -> dict[str, float]:
    texts = {"stiffness_n_per_m": stiffness, "sensitivity_m_per_v": sensitivity}
    return {name: float(text) for name, text in texts.items() if text}


def load_curves(path: str, stiffness: str | None, sensitivity: str | None, table: str | None, report: int) -> Found:
    """Return the curves of a file.

    Facts: shape of the grid, its sides [m] and spring constant [N/m]. Arrays: column and row of each curve, number of
    points of its approach and its retraction, and all heights [m] and forces [N], one curve after another.

    Args:
        path: The file.
        stiffness: The spring constant [N/m] that replaces that of the file, as text.
        sensitivity: The sensitivity [m/V] that replaces that of the file, as text.
        table: The user's description of a text table (`text_curves.TableOptions`), as JSON.
        report: File descriptor to which the progress is written.
    """
    constants = _given(stiffness, sensitivity)
    places, counts, columns = [], [], []
    with _open(path, constants, text_curves.table_options_of(table)) as curves:
        facts: dict[str, Any] = {"shape": curves.shape, "sides": curves.sides_m}
        for read, share in curves.each:
            curve = read()
            facts.setdefault("stiffness_n_per_m", constants_of(curve, constants)[0])
            factor = factor_to_force(curve, constants)
            ways = [(z, factor * value) for z, value in map(_in_order, curve.ways)]
            places.append(curve.place)
            counts.append([len(way[0]) for way in ways])
            columns += [np.stack(way) for way in ways]
            map_libraries.tell(report, share)
    if not 0 < len(places) <= _MOST_CURVES:
        raise ValueError(f"it has {len(places)} curves; 1 to {_MOST_CURVES} are read")
    heights, forces = np.concatenate(columns, axis=1)
    return facts, [np.array(places), np.array(counts), heights, forces]


def _in_order(way: Way) -> Way:
    """Return the finite points of a branch in order of height, interpolated if they are more than MOST_POINTS."""
    sound = np.isfinite(way[0]) & np.isfinite(way[1])
    order = np.argsort(way[0][sound], kind="stable")
    z, value = way[0][sound][order], way[1][sound][order]
    if len(z) > MOST_POINTS:
        even = np.linspace(z[0], z[-1], MOST_POINTS)
        z, value = even, np.interp(even, z, value)
    return z, value


def load_one(
    path: str, number: str, stiffness: str | None = None, sensitivity: str | None = None, table: str | None = None
) -> Found:
    """Return a curve of a file by its index, from 0; `table` as in `load_curves`.

    The facts are spring constant [N/m], speed [m/s], number of points of the approach and remarks; the arrays are base
    and deflection [m].
    """
    constants, wanted, count = _given(stiffness, sensitivity), int(number), 0
    with _open(path, constants, text_curves.table_options_of(table)) as curves:
        for count, (read, _) in enumerate(curves.each, start=1):
            if count - 1 == wanted:
                return _deflections_of(read(), constants)
    raise ValueError(f"it has no curve {number}; it has {count}, and the first is 0")


def _deflections_of(curve: RecordedCurve, constants: dict[str, float]) -> Found:
    k, _ = constants_of(curve, constants)
    if k is not None and not k > 0.0:
        raise ValueError(f"its spring constant is {k:g} N/m; it must be above 0 N/m")
    factor = factor_to_force(curve, constants, as_deflection=True)
    sound = [(z[kept], value[kept]) for z, value in curve.ways if (kept := np.isfinite(z) & np.isfinite(value)).any()]
    if len(sound) < 2:
        raise ValueError("it needs an approach and a retraction")
    facts = {
        "stiffness_n_per_m": k, "speed_m_per_s": curve.speed_m_per_s, "turn": len(sound[0][0]),
        "remarks": curve.remarks,
    }  # fmt: skip
    return facts, [-np.concatenate([z for z, _ in sound]), factor * np.concatenate([value for _, value in sound])]


def load_deflections(path: str) -> Found:
    """Return the approaches of a file of curves; of a large map only the first ones.

    Arrays: the number of points of each; then heights [m] and raw deflections [V] of all, one after another.
    """
    # With constants of 1 the force that afmformats computes is the voltage itself.
    raw = map_libraries.is_raw(path)
    constants = {"stiffness_n_per_m": 1.0, "sensitivity_m_per_v": 1.0} if raw else {}
    ways: list[tuple[Array, Array]] = []
    with _open(path, constants) as curves:
        for read, _ in curves.each:
            curve = read()
            k, sensitivity = (1.0, 1.0) if raw else (curve.stiffness_n_per_m, curve.sensitivity_m_per_v)
            parts = {"V": (1.0,), "m": (sensitivity,), "N": (k, sensitivity)}[curve.unit]
            if None in parts:
                raise ValueError("its metadata lack the sensitivity: the voltage that was read is unknown")
            z, value = _in_order(curve.ways[0])
            ways.append((z, value / float(np.prod([part for part in parts if part is not None]))))
            if len(ways) == _MOST_OF_HARD:
                break
    counts = np.array([len(z) for z, _ in ways])
    return {}, [counts, *(np.concatenate([way[side] for way in ways]) for side in (0, 1))]
