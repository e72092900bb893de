"""`telenano record`: an additional recorder that attaches to a running rig and leaves it as it was."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
import zmq
from pydantic import BaseModel

from presets import DEFAULT_SITE_FILE, site_file_named
from proto.errors import TelenanoError
from services.recorder.config import RecorderConfig
from services.recorder.live import connect
from services.recorder.node import RecorderBus, RecorderNode
from services.recorder.null_publisher import OBSERVER, NullPublisher
from services.recorder.open_recording import open_recording
from services.runtime.clock import SystemClock
from services.runtime.config import validate
from services.runtime.log import StructuredLog
from services.runtime.main import load_site
from services.runtime.node import NodeContext, NodeLoop, install_stop_signals
from services.runtime.realtime import RealtimeStatus, freeze_garbage
from services.runtime.security.keyring import Keyring, this_machine
from services.runtime.transport import Transport
from telenano.output import RawKeyboard, fail, print_json, report_errors

_KEYS_TEXT = "s new file · t snapshot · q end"


class Recorded(BaseModel):
    """What came of it."""

    path: str
    files: int
    messages: int
    lost: int
    rejected: int
    fault: str


class _Observer(RecorderNode):
    """The recorder, looked at while it works."""

    observe: Callable[["_Observer"], None]
    until_ns: int | None = None

    def on_deadline(self, now_ns: int) -> None:
        """Flush, then show how it does."""
        super().on_deadline(now_ns)
        self.observe(self)
        if self.until_ns is not None and now_ns >= self.until_ns:
            self.end()

    end: Callable[[], None]


def _nobody_looks(node: RecorderNode, end: Callable[[], None]) -> None:
    """Show nothing."""


def run_record(
    site_file: Path,
    config: RecorderConfig,
    scenario_file: Path | None = None,
    duration_s: float | None = None,
    observe: Callable[[RecorderNode, Callable[[], None]], None] = _nobody_looks,
) -> Recorded:
    """Record what is said in the rig of a site file until the time [s] is over or the process is told to stop.

    The process has no endpoint: it sends nothing, is in no one's list, and the rig does not know of it. `observe` is
    called at each flush with the node and the function that ends the recording.
    """
    clock, book = SystemClock(), load_site(site_file)
    loops: list[NodeLoop] = []

    def stop() -> None:
        for loop in loops:
            loop.stop()

    wake = install_stop_signals(stop)
    with zmq.Context[zmq.Socket[bytes]]() as context:
        network = Transport(context, clock, book, this_machine(Keyring()))
        listeners = connect(network, book, hears=config.hears)
        intake = open_recording(OBSERVER, clock, config, site_file, scenario_file)
        bus = RecorderBus(NullPublisher(clock, OBSERVER), listeners, intake, clock, wake, network)
        node = _Observer(NodeContext(OBSERVER, clock, bus, StructuredLog(OBSERVER)), config, intake)
        loop = NodeLoop(node, bus, RealtimeStatus(fifo=False, memory_locked=False))
        node.end = loop.stop
        node.observe = lambda recorder: observe(recorder, loop.stop)
        if duration_s is not None:
            node.until_ns = clock.monotonic_ns() + round(duration_s * 1e9)
        loops.append(loop)
        freeze_garbage()
        try:
            loop.run()
        finally:
            bus.close()
    return Recorded(
        path=node.path,
        files=0 if intake.rotation is None else intake.rotation.count,
        messages=intake.written,
        lost=intake.lost,
        rejected=intake.rejected,
        fault=intake.fault,
    )


class RecordKeyBindings:
    """What the keys do to a recorder."""

    def __init__(self, keys: RawKeyboard) -> None:
        self._keys = keys
        self._said = _KEYS_TEXT

    def __call__(self, node: RecorderNode, end: Callable[[], None]) -> None:
        """Act on the keys pressed and show how the recording does."""
        actions: dict[str, Callable[[], None]] = {"s": node.split, "t": node.snapshot, "q": end}
        for key in self._keys.pressed():
            try:
                self._said = _KEYS_TEXT if key in actions else f"unknown key {key!r}: {_KEYS_TEXT}"
                actions.get(key, lambda: None)()
            except TelenanoError as error:
                self._said = str(error)
        self._keys.show(f"{node.status()} · {self._said}")


def record(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Recording to make; an existing one is kept.")],
    topics: Annotated[
        list[str] | None,
        typer.Option("--topics", metavar="PATTERN", help="Only these: glob or /regular expression/ (repeatable)."),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option("--exclude", metavar="PATTERN", help="Not these (repeatable).")
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", min=0.0, metavar="S", help="End after this time [s].")
    ] = None,
    split_size: Annotated[
        int | None, typer.Option("--split-size", metavar="BYTES", help="Begin a new file at this size.")
    ] = None,
    split_interval: Annotated[
        float | None, typer.Option("--split-interval", metavar="S", help="Begin a new file after this time [s].")
    ] = None,
    quota: Annotated[int | None, typer.Option("--quota", metavar="BYTES", help="Most that all files may take.")] = None,
    quota_policy: Annotated[
        str, typer.Option("--quota-policy", metavar="stop|drop_oldest", help="What happens at the quota.")
    ] = "stop",
    snapshot: Annotated[
        float | None, typer.Option("--snapshot", metavar="S", help="Keep this time in memory, write on a trigger [s].")
    ] = None,
    snapshot_on: Annotated[
        list[str] | None,
        typer.Option("--snapshot-on", metavar="mode|fault|contact", help="Event that is a trigger (repeatable)."),
    ] = None,
    snapshot_after: Annotated[
        float, typer.Option("--snapshot-after", metavar="S", help="Go on writing after a trigger [s].")
    ] = 1.0,
    flush_interval: Annotated[
        float, typer.Option("--flush-interval", metavar="S", help="Most that a kill may lose [s].")
    ] = 0.2,
    compression: Annotated[str, typer.Option("--compression", metavar="zstd|lz4|none", help="Of each chunk.")] = "zstd",
    sync: Annotated[bool, typer.Option("--sync", help="Wait for the disk at each flush.")] = False,
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="FILE", help="Scenario to attach, which report and re-run need (YAML)."),
    ] = None,
    site_file: Annotated[
        Path,
        typer.Option("--site-file", metavar="FILE", callback=site_file_named, help="Address book of the rig (YAML)."),
    ] = DEFAULT_SITE_FILE,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object at the end.")] = False,
) -> None:
    """Attach to a running rig and record it; Ctrl-C or q completes the file. Keys: s new file, t snapshot, q end."""
    with report_errors(as_json):
        given: dict[str, Any] = {
            "directory": str(out.absolute().parent),
            "file_name": out.name,
            "topics": topics or [],
            "exclude": exclude or [],
            "split_size_bytes": split_size,
            "split_interval_s": split_interval,
            "quota_bytes": quota,
            "quota_policy": quota_policy,
            "snapshot_s": snapshot,
            "snapshot_on": snapshot_on or [],
            "snapshot_after_s": snapshot_after,
            "flush_interval_s": flush_interval,
            "compression": compression,
            "sync_to_disk": sync,
        }
        config = validate(RecorderConfig, given, "telenano record")
        with RawKeyboard() as keys:
            done = run_record(site_file, config, scenario, duration, RecordKeyBindings(keys))
        if done.fault:
            fail(done.fault, as_json=as_json, **done.model_dump())
        if as_json:
            print_json(done.model_dump())
        else:
            typer.echo(f"recorded {done.messages} messages, {done.lost} lost, {done.files} file(s), newest {done.path}")
