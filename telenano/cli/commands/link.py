"""`telenano link`: show and change the link of a running rig."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli.commands.session import send_command
from telenano.cli.commands.topic import open_observer
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import JsonOption, SiteFileOption, command_group
from telenano.cli.output import print_answer, report_errors
from telenano.cli.tables import counts_text
from telenano.recording.json_values import json_fields
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.observer import RIG_HINT, Observer, messages_of
from telenano.settings.config import flatten
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.settings.network_profiles import PROFILES, profile_named
from telenano.wire.errors import RigError
from telenano.wire.nodes import LINK

_PATIENCE_S = 3.0
_COUNTS = ("messages_in", "messages_out", "duplicated", "reordered", "corrupted", "queue_depth")
_DIRECTIONS = ("forward", "backward")
# The receiving end of each direction reports twice a second, so this wait [s] covers a report.
_NETWORK_S = 1.5
_NETWORK_COUNTS = ("receiving", "sent", "arrived", "late", "settled", "lost")
_PER_DATAGRAM = ("number", "arrived_ns", "delay_ns", "lost_flag")
_DELAYS = ("delay_mean_s", "delay_min_s", "delay_max_s")

app = command_group()


@app.command()
def show(site_file: SiteFileOption = DEFAULT_SITE_FILE, as_json: JsonOption = False) -> None:
    """Show the settings in force, the traffic, the delay applied, and the offset of the other site's clock.

    Between two machines it also shows the real network: datagrams sent, arrived, late, lost, and one-way delay.
    """
    with report_errors(as_json):
        with open_observer(site_file, "link/status") as observer:
            status = current_status(observer)
        network: dict[str, dict[str, Any]] = {}
        if AddressBook.load(site_file).spans_machines:
            with open_observer(site_file, "link/network") as observer:
                network = current_network(observer)
    document = {**status, "network": network} if network else status
    print_answer(document, [*status_rows(status), *network_rows(network)], as_json=as_json)


@app.command("set")
def set_keys(
    settings: Annotated[
        list[str],
        typer.Argument(metavar="KEY=VALUE", help="Settings by dotted key, such as forward.delay_s=0.02 (SI units)."),
    ],
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Change settings of the link for the messages that reach it from now on."""
    _change(settings, site_file, as_json=as_json)


@app.command()
@rules(
    Void("--show", "the profile to show", unless="NAME"),
    Void("--site-file, --rig", "which changes no rig", beside="--show"),
    Void("--site-file, --rig", "the profile to apply", unless="NAME"),
)
def profile(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Profile to apply; without it, list the profiles.")
    ] = None,
    shown: Annotated[
        bool,
        typer.Option("--show", help="Show its source, assumptions, statistics and settings, and change nothing."),
    ] = False,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Apply a named profile, instead of all settings but the seed; or list the profiles, or show one."""
    if name is not None and not shown:
        _change([f"profile={name}"], site_file, as_json=as_json)
        return
    with report_errors(as_json):
        if name is not None:
            document = profile_named(name).model_dump(mode="json")
            rows = profile_rows(document)
        else:
            rows = [{"profile": name_of_row, "what": row.about} for name_of_row, row in PROFILES.items()]
            document = {"profiles": rows}
        print_answer(document, rows, as_json=as_json)


def profile_rows(profile: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a profile, as plain data, as rows of a table."""
    rows = [{"what": "about", "value": profile["about"]}]
    for source in profile["source"]:
        rows += [{"what": "source", "value": source["cite"]}, {"what": "taken", "value": source["taken"]}]
    rows += [{"what": "assumed", "value": text} for text in profile["assumed"]]
    figures = flatten({key: profile[key] for key in ("statistics", "link")})
    return rows + [{"what": key, "value": value} for key, value in figures.items() if value is not None]


@app.command()
def clear(site_file: SiteFileOption = DEFAULT_SITE_FILE, as_json: JsonOption = False) -> None:
    """Remove every impairment from the link."""
    _change(["profile=clean"], site_file, as_json=as_json)


def _change(settings: Sequence[str], site_file: Path, *, as_json: bool) -> None:
    send_command("set", settings, LINK, site_file, as_json=as_json)


def current_status(observer: Observer) -> dict[str, Any]:
    """Return the fields of the next link/status; RigError when none is received."""
    for received in messages_of(observer, "link/status", _PATIENCE_S, 1):
        return json_fields(received.message)
    raise RigError(f"no link/status received: {RIG_HINT}")


def current_network(observer: Observer) -> dict[str, dict[str, Any]]:
    """Return the counts of the newest link/network of each direction; empty where the link sends no datagrams."""
    networks: dict[str, dict[str, Any]] = {}
    for received in messages_of(observer, "link/network", _NETWORK_S, None):
        fields = json_fields(received.message)
        networks[fields["direction"]] = {key: value for key, value in fields.items() if key not in _PER_DATAGRAM}
        if len(networks) == len(_DIRECTIONS):
            break
    return networks


def network_rows(network: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the figures of the network as rows of a table: what, forward, backward."""
    if not network:
        return []
    ways = [network.get(direction, {}) for direction in _DIRECTIONS]
    rows = [_row(f"network: {key}", *(way.get(key, "") for way in ways)) for key in _NETWORK_COUNTS]
    rows.append(_row("network: lost, of those known [%]", *map(_lost_percent, ways)))
    if any(way.get("blocked_since_ns") for way in ways):
        rows.append(_row("network: UDP blocked since", *map(_blocked_since, ways)))
    rows.append(_row("network: queue [ms]", *map(_queue_ms, ways)))
    rows.append(_row("network: line carries [Mbit/s]", *map(_carries, ways)))
    # Each end reports these of the direction in which it sends, which is the other one.
    for what, text in (("line", str), ("limit_bit_per_s", _mbit), ("unsent", str)):
        name = "limit [Mbit/s]" if what == "limit_bit_per_s" else what
        rows.append(_row(f"network: {name}", *(text(way.get(what, "")) for way in reversed(ways))))
    rows.append(_row("network: refused", *(counts_text(way.get("refused", {})) for way in ways)))
    rows += [_row(f"network: {key}", *(way[key] if way.get("delay_valid") else "" for way in ways)) for key in _DELAYS]
    clocks = [way["clock"]["uncertainty_s"] if way.get("delay_valid") else "" for way in ways]
    return [*rows, _row("network: delays known to ± [s]", *clocks)]


def _lost_percent(way: dict[str, Any]) -> str:
    """Return the share of lost datagrams among the settled ones [%]; those of the last second may still arrive."""
    settled = way.get("settled")
    return f"{100.0 * way['lost'] / settled:.1f}" if settled else ""


def _blocked_since(way: dict[str, Any]) -> str:
    since_ns = way.get("blocked_since_ns")
    return f"{datetime.fromtimestamp(since_ns * 1e-9, UTC):%H:%M:%S} UTC" if since_ns else ""


def _queue_ms(way: dict[str, Any]) -> str:
    """Return the queue of a direction with its interval [ms]; reports of earlier versions have none."""
    queue_s, *ends_s = (way.get(key) for key in ("queue_s", "queue_low_s", "queue_high_s"))
    interval = (
        "" if None in ends_s else " ({:.1f} to {:.1f})".format(*(1e3 * end_s for end_s in ends_s if end_s is not None))
    )
    return "" if queue_s is None else f"{1e3 * queue_s:.1f}{interval}"


def _carries(way: dict[str, Any]) -> str:
    """Return the capacity of a direction with its interval [Mbit/s], whose upper end may be open."""
    low, high = way.get("capacity_low_bit_per_s"), way.get("capacity_high_bit_per_s")
    interval = "" if low is None else f" ({_mbit(low)} {'or more' if high is None else f'to {_mbit(high)}'})"
    return _mbit(way.get("capacity_bit_per_s")) + interval


def _mbit(bit_per_s: float | str | None) -> str:
    return f"{bit_per_s * 1e-6:.3g}" if isinstance(bit_per_s, int | float) else ""


def status_rows(status: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a status as rows of a table: what, forward, backward."""
    ways = (status["forward"], status["backward"])
    rows: list[dict[str, Any]] = [_row("profile", *(way["profile"] for way in ways))]
    keys = sorted({key for way in ways for key in way["settings"]})
    rows += [_row(key, *(way["settings"].get(key, "") for way in ways)) for key in keys]
    rows += [_row(key, *(way[key] for way in ways)) for key in _COUNTS]
    rows.append(_row("dropped", *(counts_text(way["dropped"]) for way in ways)))
    rows += [_row(key, *(way[key] if way["delay_valid"] else "" for way in ways)) for key in _DELAYS]
    clock = status["clock"]
    if clock["valid"]:
        rows.append(_row("clock offset of the slave [s]", clock["offset_s"], f"± {clock['uncertainty_s']:.6f}"))
    return rows


def _row(what: str, forward: Any, backward: Any) -> dict[str, Any]:
    return {"what": what, "forward": forward, "backward": backward}
