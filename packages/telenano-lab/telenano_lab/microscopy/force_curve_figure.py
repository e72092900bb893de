"""The figure of force curves."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from telenano_lab.microscopy.adhesion_fit import AdhesionFit
from telenano_lab.microscopy.force_curve import Curve, Half, Marks


def curve_figure(pairs: Sequence[tuple[Curve, Marks]], fit: AdhesionFit | None = None) -> Figure:
    """Draw curves beside each other, each with the contact C and the release D of Fig. 5, and the pull-off.

    The fit of a contact, where there is one, comes last, with its residuals below.
    """
    count = len(pairs) + (fit is not None)
    figure = Figure(figsize=(7.0 * count, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(4, count)
    for place, (one, points) in enumerate(pairs):
        axes = figure.add_subplot(grid[:, place])
        zero = points.contact_base_m or 0.0
        for half, label, colour in ((one.approach, "approach", "tab:blue"), (one.retract, "retraction", "tab:red")):
            axes.plot((half.base_m - zero) * 1e9, half.force_n * 1e9, label=label, color=colour, linewidth=1.0)
        wet = points.break_base_m is not None
        named = (
            ("C", points.snap_in_base_m, points.snap_in_force_n),
            ("pull-off" if wet else "D, pull-off", points.pull_off_base_m, points.pull_off_force_n),
            ("D", points.break_base_m, _force_at(one.retract, points.break_base_m)),
        )
        for name, base_m, force_n in named:
            if base_m is not None and force_n is not None:
                axes.annotate(name, ((base_m - zero) * 1e9, force_n * 1e9), textcoords="offset points", xytext=(6, -12))
                axes.plot([(base_m - zero) * 1e9], [force_n * 1e9], "ko", markersize=3)
        axes.axhline(0.0, color="0.7", linewidth=0.6)
        # The margin leaves room for the label of the deepest mark.
        axes.margins(y=0.12)
        axes.set_xlabel("base towards the sample, 0 where the force passes zero on the way back [nm]")
        axes.set_ylabel("force on the tip [nN]")
        axes.set_title(f"{one.model.replace('_', '-')}, k = {one.stiffness_n_per_m:g} N/m")
        axes.legend(loc="upper left")
    if fit is not None:
        _draw_fit(fit, figure.add_subplot(grid[:3, count - 1]), figure.add_subplot(grid[3, count - 1]))
    return figure


def _draw_fit(fit: AdhesionFit, above: Axes, below: Axes) -> None:
    """Draw the fitted contact, and its residuals below."""
    base_m, measured_n, model_n = fit.fitted
    base_nm = (base_m - base_m.max()) * 1e9
    above.plot(base_nm, measured_n * 1e9, ".", color="tab:red", markersize=3, label="retraction, measured")
    above.plot(base_nm, model_n * 1e9, color="black", linewidth=1.0, label="contact and zero line")
    above.set_ylabel("force on the tip [nN]")
    above.set_title(
        f"R = {fit.radius_m * 1e9:.3g} ± {fit.radius_error_m * 1e9:.2g} nm,"
        f" w = {fit.work_of_adhesion_j_per_m2 * 1e3:.3g} ± {fit.work_of_adhesion_error_j_per_m2 * 1e3:.2g} mJ/m²",
        fontsize="medium",
    )
    above.legend(loc="upper left")
    above.sharex(below)
    above.tick_params(labelbottom=False)
    below.plot(base_nm, (measured_n - model_n) * 1e12, ".", color="tab:red", markersize=3)
    below.axhline(0.0, color="0.4", linewidth=0.8)
    below.set_ylabel("residual [pN]")
    below.set_xlabel("base, 0 where it turned [nm]")


def _force_at(half: Half, base_m: float | None) -> float | None:
    """Return the force [N] at the point of a branch that is nearest to a base [m]."""
    return None if base_m is None else float(half.force_n[int(np.argmin(np.abs(half.base_m - base_m)))])
