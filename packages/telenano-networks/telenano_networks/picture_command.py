"""`telenano link picture`: what networks do to messages, drawn over one another."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telenano.cli.sample_options import results_in
from telenano.extend.commands import JsonOption, print_json, report_errors

if TYPE_CHECKING:
    import numpy as np

    from telenano_networks.line_log import LineLog

# Messages of this rate are sent for so long.
_PERIOD_NS, _SECONDS, _SIZE_BYTES = 5_000_000, 600, 200


def picture(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Networks, as `telenano link profile` lists.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the picture.")] = Path("out/networks"),
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the networks.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Draw what networks do forward: delay, its distribution and autocorrelation, stalls, losses, and age.

    The age is that of the newest message at a reader. 200 messages a second are sent for ten minutes.
    """
    with report_errors(as_json):
        import numpy as np

        from telenano_networks.line_fit import ages_s
        from telenano_networks.line_page import lines_figure

        lines = {name: carried(name, seed) for name in names}
        with results_in(out) as folder:
            lines_figure(lines).savefig(folder / "networks.png", dpi=110)
        figures = {
            name: {
                "delay_ms": dict(zip(("p50", "p99"), _quantiles_ms(log.segments[0].delay_s), strict=True)),
                "age_ms": dict(zip(("p50", "p99"), _quantiles_ms(ages_s(log)), strict=True)),
                "lost": float(np.isnan(log.segments[0].delay_s).mean()),
            }
            for name, log in lines.items()
        }
    if as_json:
        print_json({"networks": figures, "picture": str(out / "networks.png")})
    else:
        typer.echo(f"{out / 'networks.png'}: {', '.join(names)}")


def _quantiles_ms(values_s: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> list[float]:
    import numpy as np

    return [round(1e3 * float(value), 4) for value in np.nanquantile(values_s, (0.5, 0.99))]


def carried(name: str, seed: int) -> "LineLog":
    """Return what a network does to messages, as a log of them; ConfigError names the networks that there are."""
    import numpy as np

    from services.delay_node.config import parse_settings
    from services.delay_node.engine import fates_of
    from telenano_networks.line_log import LineLog, Segment

    times_ns = range(0, _SECONDS * 10**9, _PERIOD_NS)
    settings = parse_settings({"profile": name, "seed": seed})
    fates = [one for one in fates_of(settings, "forward", "udp", times_ns, _SIZE_BYTES) if one.copy == 0]
    delay_s = np.array([np.nan if one.dropped else 1e-9 * one.delay_ns for one in fates])
    return LineLog((Segment(1e-9 * np.array(times_ns, dtype=np.float64), delay_s),), round_trip=False)
