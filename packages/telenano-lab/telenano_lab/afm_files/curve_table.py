"""One table of all force curves in files: a row per curve, with figures and errors, or the reason of refusal.

    import telenano
    frame = telenano.curves("map.npz", model="hertz", radius_m=30e-9)      # pandas
    frame.query("verdict == 'fitted'")[["x_m", "y_m", "modulus_pa", "modulus_error_pa"]]
    frame.attrs["units"]["modulus_pa"]                                     # "Pa"

A file may hold one curve or a map of thousands; a folder stands for all its files. `microscopy.curve_fit` fits them.
"""

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from telenano.wire import ConfigError
from telenano_lab.afm_files.map_files import MAP_SUFFIXES, Curves, MapOptions, read_curves
from telenano_lab.microscopy.curve_fit import ContactShape, CurveFit, MeasuredWays, fit_curve

if TYPE_CHECKING:
    import pandas

FITTED, REFUSED = "fitted", "refused"
# The columns and their units.
UNITS = {
    "file": "", "curve": "", "x_m": "m", "y_m": "m", "model": "", "verdict": "", "reason": "",
    "contact_m": "m", "contact_error_m": "m", "modulus_pa": "Pa", "modulus_error_pa": "Pa", "adhesion_n": "N",
    "adhesion_error_n": "N", "residual_n": "N", "wander_n": "N", "indentation_m": "m", "load_n": "N",
    "modulus_change": "", "modulus_change_error": "", "points": "",
}  # fmt: skip


class FittedCurve(NamedTuple):
    """A row of the table: file, index of the curve in it, place [m], the measured curve and its fit."""

    file: str
    curve: int
    place_m: tuple[float, float]
    ways: MeasuredWays | None
    fit: CurveFit
    is_grid: bool = False

    def row(self, model: str) -> dict[str, Any]:
        """Return the row of the table as a dict by column."""
        refused = self.fit.refused
        head = {"file": self.file, "curve": self.curve, "x_m": self.place_m[0], "y_m": self.place_m[1], "model": model}
        return {**head, "verdict": REFUSED if refused else FITTED, "reason": refused, **self.fit.as_dict()}


def curves(
    files: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    model: str = "hertz",
    *,
    radius_m: float = 0.0,
    half_angle_rad: float = 0.0,
    poisson: float = 0.5,
    thickness_m: float = 0.0,
    settings: Mapping[str, Any] | None = None,
) -> "pandas.DataFrame":
    """Fit a contact to all force curves in files; return a table with a row for each.

    Args:
        files: A file, a folder, or several of them; `packages/telenano-devices/docs/fit.md` lists the formats.
        model: hertz, sneddon, dmt or jkr.
        radius_m: Radius of the tip [m], for all models but sneddon.
        half_angle_rad: Half angle of the cone [rad], for sneddon.
        poisson: Poisson ratio of the sample.
        thickness_m: Thickness of the sample on a hard ground [m]; 0 for a thick one.
        settings: Values that the files lack, as with `--set`: `{"stiffness_n_per_m": 0.1}`.

    Returns:
        A table with the units of its columns in `attrs["units"]`; a standard error beside each figure, NaN where there
        is none. `verdict` is fitted or refused, and `reason` is the reason of a refusal.

    Raises:
        ConfigError: There is no such file, the shape of the tip is missing, or no file can be read.
    """
    shape = ContactShape(model, radius_m, half_angle_rad, poisson, thickness_m).checked()
    paths = [Path(files)] if isinstance(files, str | os.PathLike) else [Path(each) for each in files]
    return frame_of(fit_files(paths, shape, settings or {}), model)


def frame_of(rows: Iterable[FittedCurve], model: str) -> "pandas.DataFrame":
    """Return the rows as a pandas table; ConfigError if pandas is missing."""
    try:
        import pandas
    except ImportError as error:
        raise ConfigError("a table of curves needs pandas: pip install pandas") from error
    frame = pandas.DataFrame([each.row(model) for each in rows], columns=list(UNITS))
    frame.attrs["units"] = dict(UNITS)
    return frame


def fit_files(
    paths: Iterable[Path],
    shape: ContactShape,
    settings: Mapping[str, Any],
    progress: Callable[[int, int, str], None] = lambda done, of, name: None,
) -> list[FittedCurve]:
    """Fit all curves of files and folders, in their order; a file that cannot be read becomes one refused row.

    Raises:
        ConfigError: There is no file, or none can be read; the message is then that of the first.
    """
    shape.checked()
    found, unread = list[FittedCurve](), list[ConfigError]()
    files = [file for path in paths for file in _files_of(path)]
    for file in files:
        try:
            read = read_curves(file, MapOptions(dict(settings)))
        except ConfigError as error:
            unread.append(error)
            reason = str(error).removeprefix(f"{file}: ")
            found.append(FittedCurve(str(file), 0, (math.nan, math.nan), None, CurveFit(refused=reason)))
            continue
        for done, each in enumerate(_fitted(file, read, shape)):
            found.append(each)
            progress(done + 1, len(read.branches), file.name)
    if len(unread) == len(files):
        raise unread[0] if unread else ConfigError("there is no file of force curves")
    return found


def _files_of(path: Path) -> list[Path]:
    """Return the path itself, if a file or a folder of waves of one map, else the sorted curve files in a folder."""
    if not path.is_dir():
        return [path]
    inside = sorted(each for each in path.iterdir() if each.is_file() and not each.name.startswith("."))
    if any(each.suffix.lower() == ".ibw" and each.stem.lower().startswith("line") for each in inside):
        return [path]
    known = [each for each in inside if each.suffix.lower() in MAP_SUFFIXES or each.suffix[1:].isdecimal()]
    if not known:
        raise ConfigError(f"{path}: holds no file of force curves; these end with {', '.join(MAP_SUFFIXES)}")
    return known


def _fitted(file: Path, read: Curves, shape: ContactShape) -> Iterable[FittedCurve]:
    for number, place, branches in zip(read.numbers, read.places_m, read.branches, strict=True):
        empty = np.zeros(0)
        back = branches[1] if len(branches) > 1 else (empty, empty)
        ways = MeasuredWays(*branches[0], *back, read.stiffness_n_per_m)
        yield FittedCurve(str(file), number, place, ways, fit_curve(ways, shape), read.is_grid)


def counted(rows: list[FittedCurve]) -> dict[str, Any]:
    """Return the numbers of fitted and refused curves, and how often each reason occurs."""
    reasons: dict[str, int] = {}
    for each in rows:
        if each.fit.refused:
            # Figures are stripped, because they differ from curve to curve while the reason does not.
            short = each.fit.refused.partition(":")[0] if ":" in each.fit.refused else each.fit.refused
            words = re.sub(r"-?\d[\d.]*(e[-+]?\d+)?", "…", short)
            reasons[words] = reasons.get(words, 0) + 1
    refused = sum(reasons.values())
    return {
        "curves": len(rows),
        "fitted": len(rows) - refused,
        "refused": refused,
        "refused_share": refused / len(rows),
        "reasons": dict(sorted(reasons.items(), key=lambda row: -row[1])),
    }
