"""`telenano curve`: a force curve in simulated time or of a running rig, its marks, and a measured one beside it."""

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli import (
    JsonOption,
    SiteFileOption,
    Void,
    command_group,
    print_document,
    progress,
    report_errors,
    results_in,
    rules,
    say,
    validated,
    with_options,
)
from telenano.settings import DEFAULT_SITE_FILE, CurveSettings, flag_overrides, validate
from telenano.signals import finishing
from telenano.wire import ConfigError, RigError
from telenano_lab.microscopy.program_view import LIVE_RULES, AfmOption, LiveOption, decided_by_rig, follow_program

if TYPE_CHECKING:
    from telenano.wire import Scalar
    from telenano_lab.microscopy.force_curve import Curve


class CurveModel(StrEnum):
    """Model of the simulated cantilever."""

    QUASI_STATIC = "quasi_static"
    DYNAMIC = "dynamic"


app = command_group()


@app.callback(invoke_without_command=True, no_args_is_help=False)
@rules(
    *LIVE_RULES,
    decided_by_rig("--model, --points"),
    decided_by_rig("--afm", unless="--overlay"),
    Void("--set, --number, --reduced-modulus", "which names the measured curve", unless="--overlay"),
)
@with_options(CurveSettings)
def curve(
    context: typer.Context,
    given: dict[str, Any],
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for curve.h5 and curve.png.")] = None,
    points: Annotated[int, typer.Option("--points", metavar="N", help="Points of each way.")] = 1000,
    model: Annotated[
        CurveModel, typer.Option("--model", help="quasi_static: k zeta = F(h); dynamic: Eq. 4 in full.")
    ] = CurveModel.QUASI_STATIC,
    afm: AfmOption = None,
    overlay: Annotated[
        Path | None,
        typer.Option("--overlay", metavar="FILE", help="Measured curve to draw beside it, as a package reads it."),
    ] = None,
    number: Annotated[
        int, typer.Option("--number", min=0, metavar="N", help="Which curve of a map to overlay; the first is 0.")
    ] = 0,
    lacking: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Facts that the measured file lacks: stiffness_n_per_m, sensitivity_m_per_v; for a text table "
            "columns=1,2, way_unit=nm, value_unit=nN, value_sign=-1.",
        ),
    ] = None,
    reduced_modulus: Annotated[
        float | None,
        typer.Option(
            "--reduced-modulus",
            metavar="PA",
            help="Reduced modulus of the measured contact [Pa]; default: that of --afm.",
        ),
    ] = None,
    live: LiveOption = False,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Approach and retract, mark snap-in, contact, pull-off and break, write HDF5 (afmformats) and a figure."""
    if context.invoked_subcommand is not None:
        return
    with report_errors(as_json):
        if out is None:
            raise ConfigError("missing option '--out'")
        validated(CurveSettings, given)
        import telenano_lab.microscopy.force_curve as curves
        from telenano.sections import AfmConfig
        from telenano_lab.microscopy.adhesion_fit import fit_adhesion
        from telenano_lab.microscopy.force_curve_figure import curve_figure

        config = validate(AfmConfig, flag_overrides(afm or ()), "--afm")
        measured = None if overlay is None else curves.read_measured(overlay, number, flag_overrides(lacking or ()))
        # A signal while the files are written must not lose a curve of a real tip.
        with finishing() as finish, results_in(out) as folder:
            if live:
                curve_taken = _live(site_file, CurveSettings(**given), given, finish, as_json=as_json)
            else:
                with progress("curve", 2 * points, shown=not as_json) as show:
                    s = CurveSettings(**given)
                    curve_taken = curves.force_curve(
                        config, s.start_m, s.load_n, points, s.speed_m_per_s,
                        dynamic=model is CurveModel.DYNAMIC, progress=show,
                    )  # fmt: skip
            finish()
            marks = curves.marks_of(curve_taken)
            other = None if measured is None else (measured, curves.marks_of(measured))
            fit: dict[str, Any] | None = None
            contact = None
            if measured is not None:
                # A curve that this contact does not describe is still drawn.
                try:
                    contact = fit_adhesion(measured, config, reduced_modulus)
                    fit = contact.as_dict()
                except ConfigError as error:
                    fit = {"refused": f"{error} with --reduced-modulus" if reduced_modulus is None else str(error)}
            pairs = [(curve_taken, marks), *([] if other is None else [other])]
            curves.write_hdf5(folder / "curve.h5", curve_taken)
            curve_figure(pairs, contact).savefig(folder / "curve.png", dpi=130)
    document = {"model": curve_taken.model, "stiffness_n_per_m": curve_taken.stiffness_n_per_m, **marks.as_dict()}
    if other is not None:
        document["measured"] = {"stiffness_n_per_m": other[0].stiffness_n_per_m, **other[1].as_dict()}
        document["measured"]["assumed"] = list(other[0].remarks)
    if fit is not None:
        document["fit"] = fit
    document["files"] = [str(out / "curve.h5"), str(out / "curve.png")]
    print_document(document, str(out), as_json=as_json)
    if finish.exit_code:
        say(f"interrupted; {out} is complete")
        raise typer.Exit(finish.exit_code)


def _live(
    site_file: Path,
    settings: CurveSettings,
    given: "dict[str, Scalar]",
    on_end: Callable[[], None],
    *,
    as_json: bool,
) -> "Curve":
    """Take a curve with a running rig; RigError if it ended before it was complete."""
    from telenano_lab.microscopy.force_curve import curve_of_samples
    from telenano_lab.microscopy.live_program import LiveCurve

    samples = LiveCurve()
    # The rig decides the values that were not given.
    parameters: dict[str, Scalar] = {"program": "curve", **{f"curve.{name}": value for name, value in given.items()}}
    report = follow_program(site_file, parameters, samples, as_json=as_json, on_end=on_end)
    if report.state != "finished":
        raise RigError(report.text)
    s = settings
    return curve_of_samples(samples.base_m, samples.deflection_m, samples.force_n, -s.start_m, s.speed_m_per_s)
