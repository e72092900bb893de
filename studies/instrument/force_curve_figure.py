"""The figure of force curves."""

from collections.abc import Sequence

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from studies.instrument.force_curve import Curve, Marks


def curve_figure(pairs: Sequence[tuple[Curve, Marks]]) -> Figure:
    """Draw curves beside each other, each with its marks."""
    count = len(pairs)
    figure = Figure(figsize=(7.0 * count, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    for place, (one, points) in enumerate(pairs, start=1):
        axes = figure.add_subplot(1, count, place)
        zero = points.contact_base_m or 0.0
        for half, label, colour in ((one.approach, "approach", "tab:blue"), (one.retract, "retraction", "tab:red")):
            axes.plot((half.base_m - zero) * 1e9, half.force_n * 1e9, label=label, color=colour, linewidth=1.0)
        named = (
            ("A", points.snap_in_base_m, points.snap_in_force_n),
            ("B", points.contact_base_m, 0.0),
            ("C", points.pull_off_base_m, points.pull_off_force_n),
            ("D", points.break_base_m, 0.0),
        )
        for name, base_m, force_n in named:
            if base_m is not None and force_n is not None:
                axes.annotate(name, ((base_m - zero) * 1e9, force_n * 1e9), textcoords="offset points", xytext=(6, -12))
                axes.plot([(base_m - zero) * 1e9], [force_n * 1e9], "ko", markersize=3)
        axes.axhline(0.0, color="0.7", linewidth=0.6)
        axes.set_xlabel("base towards the sample, 0 at contact (B) [nm]")
        axes.set_ylabel("force on the tip [nN]")
        axes.set_title(f"{one.model.replace('_', '-')}, k = {one.stiffness_n_per_m:g} N/m")
        axes.legend(loc="upper left")
    return figure
