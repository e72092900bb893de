"""`telenano link picture`: draw the effect of networks on messages over one another."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telenano.cli import JsonOption, print_json, report_errors, results_in

if TYPE_CHECKING:
    import numpy as np

    from telenano_lab.networks.line_log import LineLog
    from telenano_lab.networks.line_page import Curves

# The interval between messages [ns].
_PERIOD_NS = 5_000_000
# The time for which they are sent [s].
_SECONDS = 600
_SIZE_BYTES = 200
# The most networks that are drawn over one another.
_MOST_OVER_ONE_ANOTHER = 8


def picture(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Networks, as `telenano link profile` lists.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the picture.")] = Path("out/networks"),
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the networks.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Draw the forward direction of networks: delay, its distribution and autocorrelation, stalls, losses, and age.

    The age is that of the newest message at a reader. 200 messages a second are sent for ten minutes. There is a
    picture of each network, one of up to eight over one another, and the curves in networks.json.
    """
    with report_errors(as_json):
        import numpy as np

        from telenano_lab.networks.line_fit import ages_s
        from telenano_lab.networks.line_page import curves_of, lines_figure, network_figure

        lines = {name: carried(name, seed) for name in names}
        curves = {name: curves_of(log) for name, log in lines.items()}
        with results_in(out) as folder:
            (folder / "networks.json").write_text(curves_text(curves), encoding="utf-8")
            if len(lines) <= _MOST_OVER_ONE_ANOTHER:
                lines_figure(lines).savefig(folder / "networks.png", dpi=110)
            for name, drawn in curves.items():
                network_figure(name, drawn).savefig(folder / f"{name}.png", dpi=80)
        figures = {
            name: {
                "delay_ms": dict(zip(("p50", "p99"), _quantiles_ms(log.segments[0].delay_s), strict=True)),
                "age_ms": dict(zip(("p50", "p99"), _quantiles_ms(ages_s(log)), strict=True)),
                "lost": float(np.isnan(log.segments[0].delay_s).mean()),
            }
            for name, log in lines.items()
        }
    if as_json:
        print_json({"networks": figures, "files": str(out)})
    else:
        typer.echo(f"{out}: a picture and the curves of {', '.join(names)}")


def curves_text(curves: "Mapping[str, Curves]") -> str:
    """Return the curves of networks as the page of the operator reads them, with a line for each network."""
    from telenano_lab.networks.line_page import SLOWER

    rows = (f"{json.dumps(name)}:{json.dumps(one._asdict(), separators=(',', ':'))}" for name, one in curves.items())
    return "".join(('{"slower":', json.dumps(SLOWER), ',"networks":{\n', ",\n".join(rows), "\n}}\n"))


def _quantiles_ms(values_s: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> list[float]:
    import numpy as np

    return [round(1e3 * float(value), 4) for value in np.nanquantile(values_s, (0.5, 0.99))]


def carried(name: str, seed: int) -> "LineLog":
    """Return the delays of messages over a network, as a log of them; ConfigError lists the known networks."""
    import numpy as np

    from telenano.settings import LinkSettings
    from telenano_lab.networks.line_draws import delays_ns
    from telenano_lab.networks.line_log import LineLog, Segment

    times_ns = range(0, _SECONDS * 10**9, _PERIOD_NS)
    settings = LinkSettings.of({"profile": name, "seed": seed})
    delay_s = 1e-9 * delays_ns(settings, "udp", times_ns, _SIZE_BYTES)
    return LineLog((Segment(1e-9 * np.array(times_ns, dtype=np.float64), delay_s),), round_trip=False)
