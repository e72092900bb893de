"""Figures of a table of force curves: a map of each quantity, and three of the fits."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from telenano_lab.afm_files.curve_table import FittedCurve
from telenano_lab.microscopy.image_files import readable

Array = npt.NDArray[np.float64]
Places = npt.NDArray[np.int64]

_QUANTITIES = (
    ("contact_m", "Contact point", "m"),
    ("modulus_pa", "Modulus", "Pa"),
    ("adhesion_n", "Adhesion", "N"),
    ("residual_n", "Residual of the fit, RMS", "N"),
)
# The three fits stand at these quantiles of the residual relative to the load.
_SHOWN = (0.1, 0.5, 0.9)


def map_figure(rows: Sequence[FittedCurve], title: str) -> Figure:
    """Draw each quantity over the places of a map, or over the index of the curve; refused curves are grey."""
    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize="medium")
    grid = _grid_of(rows)
    for axes, (name, label, unit) in zip(figure.subplots(2, 2).ravel(), _QUANTITIES, strict=True):
        values = np.array([np.nan if each.fit.refused else getattr(each.fit, name) for each in rows])
        sound = values[np.isfinite(values)]
        # Heights of a scanner have no absolute zero.
        zero = float(sound.min()) if name == "contact_m" and len(sound) and grid is not None else 0.0
        factor, shown_unit = readable(sound - zero, unit)
        if grid is None:
            _draw_row(axes, rows, name, factor)
            axes.set_ylabel(f"{label} [{shown_unit}]")
        else:
            _draw_map(axes, figure, grid, (values - zero) * factor, f"{label} [{shown_unit}]")
    return figure


def _grid_of(rows: Sequence[FittedCurve]) -> tuple[Array, Array, Places, Places] | None:
    """Return x and y of the columns and lines of a map, and each curve's indices into them; None without a map."""
    if len({each.file for each in rows}) != 1 or not all(each.is_grid for each in rows):
        return None
    x, xs = np.unique([each.place_m[0] for each in rows], return_inverse=True)
    y, ys = np.unique([each.place_m[1] for each in rows], return_inverse=True)
    return x, y, xs.astype(np.int64), ys.astype(np.int64)


def _draw_map(axes: Axes, figure: Figure, grid: tuple[Array, Array, Places, Places], values: Array, label: str) -> None:
    x, y, xs, ys = grid
    image = np.full((len(y), len(x)), np.nan)
    image[ys, xs] = values
    sides = [float(each[1] - each[0]) if len(each) > 1 else 1e-9 for each in (x, y)]
    factor, unit = readable(np.array([x[-1] - x[0] + sides[0], y[-1] - y[0] + sides[1]]), "m")
    extent = (factor * float(x[0] - 0.5 * sides[0]), factor * float(x[-1] + 0.5 * sides[0]),
              factor * float(y[0] - 0.5 * sides[1]), factor * float(y[-1] + 0.5 * sides[1]))  # fmt: skip
    axes.set_facecolor("0.75")
    # An outlier must not determine the colour scale of all other curves.
    sound = values[np.isfinite(values)]
    low, high = (np.percentile(sound, (1.0, 99.0)).tolist()) if len(sound) else (0.0, 1.0)
    shown = axes.imshow(image, origin="lower", extent=extent, cmap="viridis", vmin=low, vmax=max(high, low + 1e-12))
    figure.colorbar(shown, ax=axes, label=label, extend="both" if len(sound) > 100 else "neither")
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")


def _draw_row(axes: Axes, rows: Sequence[FittedCurve], name: str, factor: float) -> None:
    number = np.arange(len(rows))
    values = factor * np.array([getattr(each.fit, name) for each in rows])
    head, tail = name.rpartition("_")[::2]
    errors = factor * np.array([getattr(each.fit, f"{head}_error_{tail}", 0.0) for each in rows])
    kept = np.array([not each.fit.refused for each in rows])
    axes.errorbar(number[kept], values[kept], 1.96 * errors[kept], fmt=".", color="tab:blue", capsize=2, lw=0.8)
    for place in number[~kept]:
        axes.axvspan(place - 0.5, place + 0.5, color="0.85", lw=0.0)
    axes.set_xlabel("number of the curve (interval of 95 %; grey: refused)")
    axes.margins(x=0.02)


def fits_figure(rows: Sequence[FittedCurve]) -> Figure | None:
    """Draw three fitted curves, at the best tenth, the median and the worst tenth; None if no curve was fitted."""
    fitted = sorted(
        (each for each in rows if not each.fit.refused and each.fit.shown is not None),
        key=lambda each: each.fit.residual_n / max(each.fit.load_n, 1e-15),
    )
    if not fitted:
        return None
    places = dict.fromkeys(min(int(share * len(fitted)), len(fitted) - 1) for share in _SHOWN)
    chosen = [fitted[place] for place in places]
    figure = Figure(figsize=(5.2 * len(chosen), 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(chosen), squeeze=False, height_ratios=(3, 1), sharex="col")
    for column, each in enumerate(chosen):
        _draw_fit(axes[0, column], axes[1, column], each)
    axes[0, 0].set_ylabel("force on the tip [nN]")
    axes[1, 0].set_ylabel("residual [pN]")
    return figure


def _draw_fit(above: Axes, below: Axes, each: FittedCurve) -> None:
    fit, ways, shown = each.fit, each.ways, each.fit.shown
    assert ways is not None and shown is not None
    for height, force, colour, label in (
        (ways.approach_m, ways.approach_n, "tab:blue", "approach"),
        (ways.retract_m, ways.retract_n, "tab:red", "retraction"),
    ):
        if len(height):
            above.plot((height - fit.contact_m) * 1e9, force * 1e9, ".", ms=2, color=colour, label=label, alpha=0.6)
    place = (-shown.base_m - fit.contact_m) * 1e9
    # Nothing was fitted between the contact and the end away from the sample.
    gaps = np.flatnonzero(np.abs(np.diff(place)) > 5.0 * np.median(np.abs(np.diff(place)))) + 1
    for number, part in enumerate(np.split(np.arange(len(place)), gaps)):
        above.plot(place[part], shown.model_n[part] * 1e9, "k-", lw=1.2, label=None if number else "fit")
    above.axvline(0.0, color="0.6", lw=0.7)
    factor, unit = readable(np.array([fit.modulus_pa]), "Pa")
    above.set_title(
        f"curve {each.curve}: ({factor * fit.modulus_pa:.3g} ± {factor * fit.modulus_error_pa:.2g}) {unit}",
        fontsize="medium",
    )
    above.legend(loc="upper right", fontsize="small", frameon=False)
    below.plot(place, (shown.measured_n - shown.model_n) * 1e12, ".", ms=2, color="0.3")
    below.axhline(0.0, color="0.6", lw=0.7)
    below.set_xlabel("height of the base over the contact point [nm]")
