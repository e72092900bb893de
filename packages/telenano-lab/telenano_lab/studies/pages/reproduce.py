"""Reproduce figures of the paper, and evaluate its equations with the numbers of Table 2, on one page."""

import json
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from telenano.afm import cohesive_stress_pa, reduced_modulus_pa
from telenano.analysis import Page, cell_text, png_of
from telenano.files import atomic_file
from telenano.sections import AfmConfig
from telenano.wire import RigError
from telenano_lab.microscopy.curve_models import ModelRow, compare_models
from telenano_lab.microscopy.force_curve import Curve, force_curve, marks_of
from telenano_lab.microscopy.simulated_image import SimulatedImage, take_image
from telenano_lab.studies.option_values import section_of_instrument
from telenano_lab.studies.pages.live_figures import run_scenario, tactile_figure, tactile_path
from telenano_lab.studies.pages.paper_equations import cantilever_rows, contact_rows, control_rows, device_rows

FIGURES = ("equations", "fig5", "fig6", "models", "fig8", "fig10", "fig12")
Progress = Callable[[str, int, int], None]
# Speed at which 1000 points of approach and of retraction are one sample per millisecond [m/s].
_FIG6_SPEED_M_PER_S = 45e-9
# The paper's statement on each figure, and differences here.
_BESIDE_THE_PAPER = {
    "fig5": "The paper: the tip contacts with the sample at C and leaves it at D during retracting; the hysteresis is"
    " energy that is lost. The same here, where C is the forming of the meniscus, as a cantilever of 40 N/m does not"
    " snap, and D is its break; the paper draws F over the distance h, this figure over the base.",
    "fig6": "The paper: measured on mica, nearly linear in contact, with electrical and environmental noise to be seen."
    " The same here, first without noise, then with that of the paper's own bridge (instrument paper_bridge): 1.27 mV"
    " of Johnson noise are 0.2 nm, or 1.6 nN, and as much again is taken for its 1/f noise. Both ways are then apart in"
    " contact by hysteresis and creep of the piezo, which turns before it presses with 20 nN; the jumps at C and D"
    " drown, and the pull-off does not. Tip and sample are those of Table 2, as the paper does not tell all of them.",
    "fig8": "The paper: dots of about 5 nm radius and 10 nm height. Here they are wider, as the tip of 10 nm radius"
    " sees them; their places are drawn by a seed.",
    "fig10": "The paper: upward jumps of the hand stand for the dots, and x_m goes with alpha_p x_s. The same here; the"
    " hand stays below the tops by what sample and device give way.",
    "fig12": "The paper: the operator pushes from 0.8 s on, the tip is pulled before it touches, F_m and alpha_f F_s"
    " balance, and after the release at 4.6 s the hand goes back to the point of contact. The same here; F_m is 1.05"
    " times alpha_f F_s, as Eq. 17 has it for K_f = 20. The arrows in (c) are where the instrument states that the"
    " meniscus forms and the contact begins. At the meniscus the force jumps by 5 nN and a cantilever of 40 N/m goes"
    " 0.12 nm: it does not snap.",
}


class Value(NamedTuple):
    """One quantity: its name, its place in the paper with the erratum, our value, the expected one, and the unit."""

    name: str
    where: str
    ours: float
    expected: float
    unit: str

    @property
    def difference(self) -> float:
        """The difference as a share of the expected value."""
        return self.ours / self.expected - 1.0


def equations() -> list[Value]:
    """Return the results of the equations for Table 2, computed by the models, with independently computed values."""
    config = AfmConfig()
    t = config.tip_sample
    humid = AfmConfig.model_validate({"tip_sample": {"relative_humidity": 0.638}}).tip_sample
    tip = config.to_params().plant.tip
    a0 = tip.contact_distance_m
    # The distance of the strongest attraction by Eq. 5.
    least = (8.0 / 60.0) ** (1.0 / 6.0) * t.sigma_m
    onset = tip.contact_onset_m
    volts = config.to_params().plant.volts_per_m
    modulus = reduced_modulus_pa(t.tip_modulus_pa, t.tip_poisson, t.sample_modulus_pa, t.sample_poisson)

    most_attractive_n, _ = tip.table.contact.pull_off()
    rows = [
        ("read-out of the bridge", "Eq. 3", volts * 1e-6, 6.25, "mV/nm"),
        ("contact distance a0", "Eq. 5", a0 * 1e9, 0.197988, "nm"),
        ("strongest attraction without water", "Eq. 5",
         tip.branch(least, contact=False, meniscus=False)[0] * 1e9, -3.797, "nN"),
        ("its distance", "Eq. 5", least * 1e9, 0.2494, "nm"),
        ("meniscus at a0", "Eq. 6, E3, E4",
         tip.bridge(a0)[0] * 1e9, -9.173, "nN"),
        ("meniscus radius at 63.8 % humidity", "Eq. 6", humid.effective_meniscus_radius_m * 1e9, 1.2, "nm"),
        ("reduced modulus E*", "Eq. 8", modulus * 1e-9, 4.31198, "GPa"),
        ("cohesive stress", "Eq. 8, E5", cohesive_stress_pa(t.work_of_adhesion_j_per_m2, a0) * 1e-9, 0.374568, "GPa"),
        ("transition parameter lambda", "Eq. 8", tip.table.contact.transition, 0.82538, ""),
        ("pull-off of the dry contact", "Eq. 7-11, E6", most_attractive_n * 1e9, -3.684, "nN"),
        ("force without indentation", "Eq. 7-11", tip.table.force(0.0)[0] * 1e9, -3.225, "nN"),
        ("hand-over distance h*", "Eq. 4, E7", onset * 1e9, 0.2735, "nm"),
        ("force there", "Eq. 4, E7", tip.branch(onset, contact=False, meniscus=False)[0] * 1e9, -3.605, "nN"),
        *((f"contact stiffness at {d:g} nm", "Eq. 7-11", tip.table.force(d * 1e-9)[1], k, "N/m")
          for d, k in ((0.0, 6.74), (0.2, 13.15), (0.5, 19.6), (1.0, 27.4), (2.0, 38.6))),
    ]  # fmt: skip
    others = [*device_rows(), *cantilever_rows(), *contact_rows(), *control_rows()]
    values = [Value(name, where, float(ours), expected, unit) for name, where, ours, expected, unit in (*rows, *others)]
    return sorted(values, key=lambda value: _equation_number(value.where))


def _equation_number(where: str) -> int:
    """Return the number of the first equation in a place of the paper; 0 without one.

    >>> _equation_number("Eq. 7-11, E6")
    7
    """
    match = re.search(r"Eq\. (\d+)", where)
    return int(match.group(1)) if match else 0


def reproduce(figures: Sequence[str], out: Path, pixels: int, progress: Progress) -> dict[str, object]:
    """Write reproduce.html with the chosen figures into a folder; return their numbers.

    If the rig of a figure did not run, the reason takes its place, and is listed under `failed` in the numbers.

    Args:
        figures: The figures, of FIGURES.
        out: The folder.
        pixels: The pixels of a line, and the lines, of the image of Fig. 8.
        progress: Called with the figure, the amount that is done, and its total.
    """
    page = Page("The paper, made again")
    summary: dict[str, object] = {}
    if "equations" in figures:
        rows = equations()
        page.heading("Equations and errata E1 to E8, with the values of Table 1 and 2 and of Fig. 12")
        head = ("quantity", "where", "ours", "expected", "unit", "difference [%]")
        page.table(head, [(r.name, r.where, r.ours, r.expected, r.unit, 100.0 * r.difference) for r in rows])
        page.paragraph(
            "Expected: computed from the equations independently of this project, with the errata corrected."
        )
        summary["equations"] = [{**row._asdict(), "difference": row.difference} for row in rows]
    for name, stiffness, words in (
        ("fig5", 40.0, "Fig. 5, force and distance in approach and retraction (simulation): Table 2"),
        ("fig6", 8.0, "Fig. 6, the same with the cantilever of the experiment, k = 8 N/m, without and with its noise"),
    ):
        if name in figures:
            config = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": stiffness}})
            curve = force_curve(config, 20e-9, 20e-9, progress=partial(progress, name))
            page.heading(words)
            summary[name] = _add_curve(page, curve)
            if name == "fig6":
                noisy = force_curve(_with_its_bridge(config), 20e-9, 20e-9, speed_m_per_s=_FIG6_SPEED_M_PER_S)
                summary["fig6_with_noise"] = _add_curve(
                    page, noisy, "The same curve with the noise of the paper's read-out bridge."
                )
            page.paragraph(_BESIDE_THE_PAPER[name])
    if "models" in figures:
        page.heading("The quasi-static cantilever beside Eq. 4 in full")
        curves = compare_models(progress=partial(progress, "models"))
        columns = (
            "k [N/m]", "pull-off [nN]", "difference [%]", "snap-in x_s [nm]", "difference [nm]", "hysteresis [aJ]",
            "difference [%]", "step [nm]",
        )  # fmt: skip
        page.table(columns, [_model_cells(row) for row in curves])
        summary["models"] = [row._asdict() for row in curves]
    if "fig8" in figures:

        def shown(n: int, of: int) -> bool:
            progress("fig8", n, of)
            return True

        config = AfmConfig.model_validate({"model": "dynamic", "sample": {"name": "dots"}})
        keys: dict[str, str | int] = {"scan.mode": "tapping", "scan.pixels": pixels, "scan.lines": pixels}
        image = take_image(config, keys, shown)
        page.heading("Fig. 8, InAs dots on 150 x 150 nm², tapping mode")
        summary["fig8"] = _add_image(page, image)
        page.paragraph(_BESIDE_THE_PAPER["fig8"])
    live: tuple[tuple[str, str, Callable[[Page, Path], dict[str, object]]], ...] = (
        ("fig10", "Fig. 10, the hand over two InAs dots: x_m solid, the surface at 0.1 cm/nm dashed", _add_tactile),
        ("fig12", "Fig. 12, a hand presses the tip onto mica, presses harder, and lets go", _add_holds),
    )
    failed: dict[str, str] = {}
    for name, words, add in live:
        if name in figures:
            progress(name, 0, 1)
            page.heading(words)
            try:
                summary[name] = add(page, run_scenario(name, out, partial(progress, name)))
                page.paragraph(_BESIDE_THE_PAPER[name])
            except RigError as error:
                failed[name] = str(error)
                page.paragraph(f"Not made: {error}")
    if failed:
        summary["failed"] = failed
    with atomic_file(out / "reproduce.html") as file:
        page.write(file)
    return summary


def _model_cells(row: ModelRow) -> tuple[float, ...]:
    return (
        row.stiffness_n_per_m,
        row.static_pull_off_n * 1e9,
        100.0 * row.pull_off_share,
        row.static_snap_in_m * 1e9,
        row.snap_in_difference_m * 1e9,
        row.static_hysteresis_j * 1e18,
        100.0 * row.hysteresis_share,
        row.step_m * 1e9,
    )


def _add_tactile(page: Page, recording: Path) -> dict[str, object]:
    path = tactile_path(recording)
    numbers: dict[str, object] = {
        "correlation": path.correlation,
        "rms_at_the_hand_m": path.rms_m,
        "greatest_at_the_hand_m": float(path.hand_m.max()),
        "speed_m_per_s": float(path.way_m[-1] / path.time_s[-1]),
    }
    page.image(png_of(tactile_figure(path)), "The upward jumps are the dots, as wide as dot and tip together.")
    page.table(("quantity", "value"), [(key, cell_text(value)) for key, value in numbers.items()])
    return numbers


def _add_holds(page: Page, recording: Path) -> dict[str, object]:
    folder = recording.parent
    page.image((folder / "fig12.png").read_bytes(), "Forces, positions, and force against distance.")
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    holds = summary.get("holds", [])
    if holds:
        page.table(tuple(holds[0]), [tuple(hold.values()) for hold in holds])
    return {"holds": holds}


def _with_its_bridge(config: AfmConfig) -> AfmConfig:
    """Return a configuration with the disturbances of the paper's own AFM."""
    return AfmConfig.model_validate({**config.model_dump(exclude_unset=True), **section_of_instrument("paper_bridge")})


def _add_curve(
    page: Page, curve: Curve, words: str = "C contact, D leaving, as in the paper; the pull-off."
) -> dict[str, object]:
    from telenano_lab.microscopy.force_curve_figure import curve_figure

    marks = marks_of(curve)
    numbers: dict[str, object] = {"stiffness_n_per_m": curve.stiffness_n_per_m, **marks.as_dict()}
    page.image(png_of(curve_figure([(curve, marks)])), words)
    page.table(("quantity", "value"), [(key, cell_text(value)) for key, value in numbers.items()])
    return numbers


def _add_image(page: Page, image: SimulatedImage) -> dict[str, object]:
    from telenano_lab.microscopy.image_files import Image, image_figure

    titles = {"Height": image.height_m, "Surface as the tip sees it": image.truth_m,
              "Difference": image.height_m - image.truth_m}  # fmt: skip
    sides = image.lines.width_m, image.lines.depth_m
    images = {title: Image(title, "m", values, *sides) for title, values in titles.items()}
    numbers: dict[str, object] = {"rms_error_m": image.rms_error_m, "correlation": image.correlation}
    page.image(png_of(image_figure(images)), f"RMS error {image.rms_error_m * 1e9:.3f} nm, free of noise.")
    page.table(("quantity", "value"), [(key, cell_text(value)) for key, value in numbers.items()])
    return numbers
