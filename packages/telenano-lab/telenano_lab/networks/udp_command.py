"""`telenano link udp`: put the link between two programs that use UDP, without any privilege."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli import (
    DurationOption,
    JsonOption,
    SiteFileOption,
    fail_incomplete,
    print_json,
    print_rows,
    report_errors,
)
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import quoted

if TYPE_CHECKING:
    from telenano.recording import RecordingWriter
    from telenano_lab.networks.network_trace import Direction
    from telenano_lab.networks.udp_ports import UdpPorts

_KEY = "delay_node@master"
# The metadata of a recording with the number of datagrams for which a socket had no room.
OVERFLOWED = "udp_overflowed"
# Killing the process loses no more of a recording than this [ns].
_FLUSH_NS = 1_000_000_000


def udp(
    listen: Annotated[
        str,
        typer.Argument(
            metavar="LISTEN",
            help="Address to which clients send: PORT of this machine alone, HOST:PORT or [HOST]:PORT; [::]:PORT for "
            "all.",
        ),
    ],
    target: Annotated[str, typer.Argument(metavar="HOST:PORT", help="Address to which the datagrams are forwarded.")],
    profile: Annotated[
        str, typer.Option("--profile", metavar="NAME", help="Network from the list of `telenano link profile`.")
    ] = "clean",
    keys: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Setting of the link, such as forward.delay_s=0.02 or seed=3."),
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE", help="Record the fate of each datagram (MCAP).")
    ] = None,
    clients: Annotated[
        int, typer.Option("--clients", metavar="N", min=1, max=1000, help="Greatest number of clients at a time.")
    ] = 64,
    duration: DurationOption = None,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Put the link between two programs that send UDP datagrams, one of which sends to LISTEN.

    Forward is from LISTEN to HOST:PORT, backward are the answers. `telenano link set`, `link profile` and `link show`
    change and show it while it runs, as that of a rig; `telenano link report` reads the file of --record afterwards.
    Ctrl-C ends it. The exit code is 3 where the recording could not be kept.
    """
    with report_errors(as_json):
        from telenano.runtime import AddressBook
        from telenano.settings import LinkSettings, flag_overrides
        from telenano_lab.networks.byte_link import ByteLinkProcess
        from telenano_lab.networks.udp_link import UdpLink
        from telenano_lab.networks.udp_ports import UdpPorts, make_room_for, place_of

        here, there = place_of(listen, "LISTEN", needs_host=False), place_of(target, "HOST:PORT", needs_host=True)
        # The text `none` stands for a missing value, as for `telenano link set`.
        flags = [f"{flag.removesuffix('none')}null" if flag.endswith("=none") else flag for flag in keys or ()]
        settings = LinkSettings.of({"profile": profile, **flag_overrides(flags)}, "the network")
        with contextlib.ExitStack() as stack:
            link = stack.enter_context(ByteLinkProcess.open(AddressBook.load(site_file)))
            ports = UdpPorts(here, there, clients)
            stack.callback(ports.close)
            keeper = None
            if record is not None:
                keeper = Keeper(_writer(record))
                stack.callback(lambda kept: kept.close(ports.overflowed()), keeper)
            make_room_for(clients)
            carrier = UdpLink(link, ports)
            link.begin(settings, carrier, ports, duration_s=duration, keep=keeper)
            typer.echo(
                f"ready: datagrams to {_shown(ports)} are forwarded to {there} over the network "
                f"{settings.network_name}; "
                "`telenano link set KEY=VALUE` changes it, Ctrl-C ends",
                err=as_json,
            )
            link.run()
            document = {
                **carrier.summary(),
                "clients_refused": ports.refused,
                "unsent": ports.unsent,
                "overflowed": ports.overflowed(),
            }
        if keeper is not None:
            document["recording"] = str(keeper.path)
    if as_json:
        print_json(document)
    else:
        print_rows(_rows(document))
        if keeper is not None:
            typer.echo(f"{keeper.path} is recorded: `telenano link report {quoted(keeper.path)}` shows it")
    if keeper is not None and keeper.fault:
        fail_incomplete([keeper.fault])


class Keeper:
    """Writes the messages of the link to a recording; if it cannot be written it ends, and the link continues."""

    def __init__(self, writer: "RecordingWriter") -> None:
        self.path, self.fault = writer.path, ""
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._flushed_ns = 0

    def __call__(self, topic: str, seq: int, t_ns: int, src: str, payload: bytes) -> None:
        """Record a message that the link has published."""
        from telenano.wire import RecordingError

        if self.fault:
            return
        try:
            if topic not in self._channels:
                self._channels[topic] = self._writer.channel(topic, src, "master")
            self._writer.write(self._channels[topic], t_ns, t_ns, seq, payload)
            if t_ns - self._flushed_ns >= _FLUSH_NS:
                self._flushed_ns = t_ns
                self._writer.flush()
        except RecordingError as error:
            self.fault = f"the recording ends before the link: {error}"

    def close(self, overflowed: Mapping["Direction", int] | None = None) -> None:
        """Complete the file, with the number of datagrams for which the link's sockets had no room, by direction."""
        from telenano.wire import RecordingError

        if self.fault:
            return
        try:
            if overflowed:
                self._writer.add_metadata(OVERFLOWED, {way: str(count) for way, count in overflowed.items()})
            self._writer.finish({"state": "stopped", "note": ""})
        except RecordingError as error:
            self.fault = str(error)


def _writer(path: Path) -> "RecordingWriter":
    from telenano.recording import RecordingWriter

    return RecordingWriter.at(path.absolute(), _KEY, "--record")


def _shown(ports: "UdpPorts") -> str:
    from telenano_lab.networks.udp_ports import Place

    return str(Place(str(ports.address[0]), int(str(ports.address[1]))))


def _rows(document: dict[str, Any]) -> list[dict[str, Any]]:
    ways = [document[way] for way in ("forward", "backward")]
    rows = [_row(what, *(way[key] for way in ways)) for what, key in _COUNTS]
    causes = sorted({cause for way in ways for cause in way["dropped"]})
    rows += [_row(f"dropped: {cause}", *(way["dropped"].get(cause, 0) for way in ways)) for cause in causes]
    for what, key in (("delay", "delay_ms"), ("sent late by", "late_ms")):
        for name, share in (("p50", "median"), ("p99", "99 %"), ("max", "longest")):
            rows.append(_row(f"{what}, {share} [ms]", *((way[key] or {}).get(name, "") for way in ways)))
    rows.append(_row("dropped: the socket had no room", *document["overflowed"].values()))
    rows.append({"what": "datagrams of refused clients", "forward": document["clients_refused"], "backward": ""})
    rows += [{"what": f"unsent: {why}", "forward": count, "backward": ""} for why, count in document["unsent"].items()]
    return rows


_COUNTS = (("arrived", "arrived"), ("sent on", "sent"), ("over the bound", "over_the_bound"), ("not sent yet", "left"))


def _row(what: str, forward: Any, backward: Any) -> dict[str, Any]:
    return {"what": what, "forward": forward, "backward": backward}
