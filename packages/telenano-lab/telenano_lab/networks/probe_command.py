"""`telenano link probe`: measure the network between two sites, as a trace, a figure and settings."""

import contextlib
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

import typer
import yaml

from telenano.cli import (
    JsonOption,
    SiteFileOption,
    Void,
    open_observer,
    print_json,
    print_rows,
    progress,
    report_errors,
    results_in,
    rules,
)
from telenano.console import send_control
from telenano.runtime import RIG_HINT, TRAIN, Command
from telenano.settings import TWO_SITES_FILE
from telenano.wire import LINK, LinkNetwork, RigError, TelenanoError
from telenano_lab.networks.network_trace import DIRECTIONS, trace_figure, traces_of, write_traces

_TOPIC = "link/network"
_SECTION = "delay_node.yaml"


@rules(Void("--duration, --site-file, --rig", "which needs no rig", beside="--from"))
def probe(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for traces, figure and settings.")] = Path(
        "out/probe"
    ),
    duration: Annotated[
        float, typer.Option("--duration", metavar="S", min=2.0, max=1e6, help="Time for which to measure [s].")
    ] = 30.0,
    recording: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Use a recording instead of a running rig."),
    ] = None,
    site_file: SiteFileOption = TWO_SITES_FILE,
    as_json: JsonOption = False,
) -> None:
    """Measure the network between two running sites: delay and loss of each datagram, each way.

    Run it at the master while both sites run (`telenano up --site ...`, also before the session begins).
    """
    with report_errors(as_json):
        reports = (
            list(_recorded(recording)) if recording is not None else _measured(site_file, duration, shown=not as_json)
        )
        traces = traces_of(reports)
        absent = [direction for direction in DIRECTIONS if direction not in traces]
        if absent:
            raise RigError(
                f"no {_TOPIC} of the direction {absent[0]} was received: does the link receive as datagrams there? "
                f"`telenano link show` says; {RIG_HINT}"
            )
        with results_in(out) as folder:
            section = write_traces(traces, folder)
            (folder / _SECTION).write_text(yaml.safe_dump(section, sort_keys=False), encoding="utf-8")
            trace_figure(traces).savefig(folder / "network.png", dpi=130)
            network: dict[str, dict[str, Any]] = {
                direction: {**trace.summary(), **_line(direction, reports)} for direction, trace in traces.items()
            }
            document = {"network": network, "replay": section, "files": str(out)}
            text = json.dumps(document, indent=2, allow_nan=False) + "\n"
            (folder / "probe.json").write_text(text, encoding="utf-8")
    if as_json:
        print_json(document)
        return
    print_rows([{"what": key, **{way: network[way][key] for way in network}} for key in network["forward"]])
    typer.echo(f"{out}: traces, network.png, probe.json; {_SECTION} has the settings that replay this network")


def _line(direction: str, reports: Sequence[LinkNetwork]) -> dict[str, Any]:
    """Return the state of the line in a direction: its capacity and longest queue, each with its interval.

    A figure is None if it is unknown.
    """
    own = [report for report in reports if report.direction == direction]
    carries = next((report for report in reversed(own) if report.capacity_bit_per_s is not None), None)
    longest = max(
        (report for report in own if report.queue_s is not None), key=lambda report: report.queue_s or 0.0, default=None
    )
    mbit = {"capacity_mbit": "capacity", "capacity_low_mbit": "capacity_low", "capacity_high_mbit": "capacity_high"}
    found_mbit = {name: getattr(carries, f"{key}_bit_per_s", None) for name, key in mbit.items()}
    queues = {"queue_max_ms": "queue_s", "queue_max_low_ms": "queue_low_s", "queue_max_high_ms": "queue_high_s"}
    found_s = {name: getattr(longest, key, None) for name, key in queues.items()}
    return {
        **{name: None if value is None else round(value * 1e-6, 3) for name, value in found_mbit.items()},
        **{name: None if value is None else round(1e3 * value, 2) for name, value in found_s.items()},
    }


def _recorded(path: Path) -> Iterator[LinkNetwork]:
    """Yield the reports in a recording, each once: at the master it has both directions, one of them as copies too."""
    from telenano.recording import Recording

    seen = set()
    for message in Recording(path).messages():
        if message.topic == _TOPIC and (message.src, message.seq) not in seen:
            seen.add((message.src, message.seq))
            yield cast(LinkNetwork, message.decode())


def _measured(site_file: Path, duration_s: float, *, shown: bool) -> list[LinkNetwork]:
    """Return the reports of a running rig within duration_s [s]."""
    newest: dict[tuple[str, int], LinkNetwork] = {}
    # If this machine may not send commands, the measurement from the start of the rig is used.
    with contextlib.suppress(TelenanoError):
        send_control(Command("set", LINK, parameters={TRAIN: True}), site_file, "master", lambda event: None)
    begin = time.monotonic()
    with (
        open_observer(site_file, _TOPIC) as observer,
        progress("probe", duration_s, shown=shown) as show,
    ):
        for observed in observer.listen(duration_s):
            message = observed.received.message
            if isinstance(message, LinkNetwork):
                newest[message.src, message.seq] = message
            show(time.monotonic() - begin)
    return sorted(newest.values(), key=lambda message: message.t_ns)
