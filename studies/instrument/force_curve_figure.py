"""The figure of force curves."""

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from studies.instrument.force_curve import Curve, Half, Marks


def curve_figure(pairs: Sequence[tuple[Curve, Marks]]) -> Figure:
    """Draw curves beside each other, each with C and D, the contact and the leaving of Fig. 5, and the pull-off."""
    count = len(pairs)
    figure = Figure(figsize=(7.0 * count, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    for place, (one, points) in enumerate(pairs, start=1):
        axes = figure.add_subplot(1, count, place)
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
        axes.set_xlabel("base towards the sample, 0 where the force passes zero on the way back [nm]")
        axes.set_ylabel("force on the tip [nN]")
        axes.set_title(f"{one.model.replace('_', '-')}, k = {one.stiffness_n_per_m:g} N/m")
        axes.legend(loc="upper left")
    return figure


def _force_at(half: Half, base_m: float | None) -> float | None:
    """Return the force at a base of a way [N]."""
    return None if base_m is None else float(half.force_n[int(np.argmin(np.abs(half.base_m - base_m)))])
