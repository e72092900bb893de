"""The figure of an assembly: the images before and after, the targets, and each particle's distance from its own."""

from typing import TYPE_CHECKING

import numpy as np

from telenano_lab.assembly.find import flattened
from telenano_lab.assembly.run import Assembly, Look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def assembly_figure(assembly: Assembly, tolerance_m: float) -> "Figure":
    """Draw an assembly; a particle within tolerance_m [m] of its target counts as placed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    before, after = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, look, title in ((before, assembly.before, "before"), (after, assembly.after, "after")):
        _image(axes, look)
        axes.set_title(f"{title}, {look.ended_s - assembly.before.began_s:.0f} s")
        for one in assembly.placed:
            axes.plot(one.target[0] * 1e6, one.target[1] * 1e6, "+", color="tab:red", markersize=12)
    for one in assembly.placed:
        is_placed = one.error_m <= tolerance_m
        after.annotate(
            f"{one.error_m * 1e9:.0f} nm",
            (one.target[0] * 1e6, one.target[1] * 1e6),
            xytext=(9, 9),
            textcoords="offset points",
            color="white" if is_placed else "tab:orange",
            fontsize=9,
        )
    placed = sum(one.error_m <= tolerance_m for one in assembly.placed)
    figure.suptitle(
        f"{placed} of {len(assembly.placed)} particles within {tolerance_m * 1e9:.0f} nm, by {assembly.pushes} pushes"
        f" and {assembly.looks} looks; red crosses are the targets"
    )
    return figure


def _image(axes: "Axes", look: Look) -> None:
    level, _ = flattened(np.nan_to_num(look.height_m, nan=float(np.nanmedian(look.height_m))))
    (x, y), (width, depth) = look.middle, look.sides_m
    left, bottom = 1e6 * (x - 0.5 * width), 1e6 * (y - 0.5 * depth)
    extent = (left, left + 1e6 * width, bottom, bottom + 1e6 * depth)
    axes.imshow(level * 1e9, origin="lower", extent=extent, cmap="viridis", interpolation="nearest")
    axes.set_xlabel("x, µm")
    axes.set_ylabel("y, µm")
