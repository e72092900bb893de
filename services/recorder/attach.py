"""An additional recorder that attaches to a running rig without changing it."""

import math
from collections.abc import Callable
from pathlib import Path

from pydantic import BaseModel

from services.recorder.intake import begin_recording
from services.recorder.node import RecorderBus, RecorderNode
from telenano.console.live_recording import connect
from telenano.recording.recorder_config import RecorderConfig
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import NullPublisher
from telenano.runtime.wiring.participant import OBSERVER, Participant, StopSignals
from telenano.wire.nodes import site_of


class AttachedRecording(BaseModel):
    """Result of an attached recording.

    `lost` counts all messages that did not arrive, `missing` only those that an impaired link did not drop; `notes` are
    sentences on other losses; `fault` is the reason why recording stopped, or empty.
    """

    path: str
    files: int
    messages: int
    lost: int
    missing: int
    notes: tuple[str, ...]
    rejected: int
    fault: str


def run_record(
    site_file: Path,
    config: RecorderConfig,
    scenario_file: Path | None = None,
    duration_s: float | None = None,
    observe: Callable[[RecorderNode], None] = lambda node: None,
) -> AttachedRecording:
    """Record the messages of the rig of a site file for `duration_s` [s], or until the process is stopped.

    The process has no endpoint: it publishes nothing and is in no site file. `observe` is called at each flush.
    """
    book, signals = AddressBook.load(site_file), StopSignals()
    with Participant.observing(book, signals.descriptor) as participant:
        clock = participant.clock
        listeners = connect(
            participant, wanted=lambda topic, node: config.subscribes(topic, site_of(node)), unknown=True
        )
        intake = begin_recording(OBSERVER, clock, config, site_file, scenario_file)
        publisher = NullPublisher(clock, OBSERVER)
        bus = RecorderBus(publisher, listeners, intake, clock, signals.descriptor, participant.network)
        until_ns = math.inf if duration_s is None else clock.monotonic_ns() + round(duration_s * 1e9)

        def on_flush(node: RecorderNode) -> None:
            observe(node)
            if clock.monotonic_ns() >= until_ns:
                node.context.request_stop()

        node = RecorderNode(participant.context(bus), config, intake, on_flush)
        signals.run(node, bus)
    return AttachedRecording(
        path=node.path,
        files=0 if intake.rotation is None else intake.rotation.count,
        messages=intake.written,
        lost=intake.lost,
        missing=intake.missing,
        notes=tuple(intake.notes),
        rejected=intake.rejected,
        fault=intake.fault,
    )
