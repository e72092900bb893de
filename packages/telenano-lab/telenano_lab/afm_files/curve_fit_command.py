"""`telenano curve fit`: fit all force curves in files; write one table, maps of the figures and three of the fits."""

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from telenano.cli import EXIT_FAILED, JsonOption, Void, print_document, progress, report_errors, results_in, rules, say
from telenano.settings import flag_overrides
from telenano.wire import ConfigError


@rules(
    Void("--half-angle", "whose cone it is", unless="--model sneddon"),
    Void("--radius", "whose tip is a cone", beside="--model sneddon"),
)
def fit(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILES", help="Files of force curves, maps of them, or folders of files.")
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="TABLE.csv", help="The table; TABLE_map.png and TABLE_fits.png beside it.")
    ],
    model: Annotated[
        Literal["hertz", "sneddon", "dmt", "jkr"],
        typer.Option(
            "--model",
            help="hertz: a sphere, sneddon: a cone, without adhesion; dmt, jkr: a sphere that adheres, hard or soft.",
        ),
    ],
    radius: Annotated[
        float, typer.Option("--radius", min=0.0, metavar="NM", help="Radius of the tip [nm]; all but sneddon.")
    ] = 0.0,
    half_angle: Annotated[
        float, typer.Option("--half-angle", min=0.0, metavar="DEG", help="Half angle of the cone [deg]; sneddon.")
    ] = 0.0,
    poisson: Annotated[
        float, typer.Option("--poisson", min=0.0, max=0.5, metavar="NU", help="Poisson ratio of the sample.")
    ] = 0.5,
    thickness: Annotated[
        float,
        typer.Option(
            "--thickness", min=0.0, metavar="NM", help="Thickness of a sample on a hard ground [nm]; 0: a thick one."
        ),
    ] = 0.0,
    most_refused: Annotated[
        float,
        typer.Option(
            "--most-refused",
            min=0.0,
            max=1.0,
            metavar="SHARE",
            help="Share of refused curves above which the command fails.",
        ),
    ] = 0.5,
    lacking: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Facts that the files lack: stiffness_n_per_m, sensitivity_m_per_v; of a text table columns=1,2, "
            "way_unit=nm, value_unit=nN, value_sign=-1.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a contact to all force curves of files: a table with a row or a refusal for each, and pictures."""
    with report_errors(as_json):
        if out.suffix.lower() != ".csv":
            raise ConfigError(f"--out {out}: must end with .csv")
        from telenano_lab.afm_files.curve_table import counted, fit_files, frame_of
        from telenano_lab.afm_files.curve_table_figure import fits_figure, map_figure
        from telenano_lab.microscopy.curve_fit import ContactShape

        shape = ContactShape(model, 1e-9 * radius, math.radians(half_angle), poisson, 1e-9 * thickness).checked()
        with progress("curves", None, shown=not as_json, counted=True) as show:
            rows = fit_files(files, shape, flag_overrides(lacking or ()), lambda done, of, name: show(done, of, name))
        found = counted(rows)
        written = {
            "table": out,
            "map": out.with_name(f"{out.stem}_map.png"),
            "fits": out.with_name(f"{out.stem}_fits.png"),
        }
        frame = frame_of(rows, model)
        with results_in(out.parent) as folder:
            frame.to_csv(folder / out.name, index=False)
            title = f"{model}: {found['fitted']} of {found['curves']} curves fitted"
            map_figure(rows, title).savefig(folder / written["map"].name, dpi=120)
            three = fits_figure(rows)
            if three is None:
                del written["fits"]
            else:
                three.savefig(folder / written["fits"].name, dpi=120)
        sound = frame[frame["verdict"] == "fitted"]
    document = {
        "model": model,
        **found,
        **{f"median_{name}": float(sound[name].median()) for name in ("modulus_pa", "adhesion_n", "residual_n")},
        "median_modulus_error_pa": float(sound["modulus_error_pa"].median()),
        "files": [str(each) for each in written.values()],
    }
    print_document(document, str(out), as_json=as_json)
    if found["refused_share"] > most_refused:
        say(
            f"{found['refused']} of {found['curves']} curves are refused, more than --most-refused {most_refused:g}:"
            f" the table has the reason of each"
        )
        raise typer.Exit(EXIT_FAILED)
