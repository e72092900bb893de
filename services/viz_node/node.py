"""The page's server as a node: it runs the web server while it waits, and publishes its health like any node."""

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

from services.viz_node.commander import RigCommander, forms
from services.viz_node.hub import Hub
from services.viz_node.live import LiveSource
from services.viz_node.page_server import PageServer
from services.viz_node.recording_files import RecordingFiles
from telenano.console.lease import Party
from telenano.console.lease_register import LeaseRegister
from telenano.console.page_hand import RigHand
from telenano.runtime.bus.bus import Refusals, ZmqBus
from telenano.runtime.bus.publisher import NullPublisher, Publisher
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.wiring.participant import Participant
from telenano.serving.access import Access
from telenano.serving.connections import Listener
from telenano.serving.serve import Tls
from telenano.wire.errors import EndpointError
from telenano.wire.received import Received


class PageBus(ZmqBus):
    """A bus that serves the page while it waits, so that a server that hangs publishes no health."""

    def __init__(
        self, participant: Participant, publisher: Publisher, server: PageServer, left_out: Iterable[Refusals]
    ) -> None:
        super().__init__(publisher, (), participant.clock, participant.wake_descriptor, participant.network)
        self._server = server
        # Messages and requests that the page refuses appear in node/health by reason, and in the log.
        for counter in left_out:
            self.count(counter)

    def wait(self, deadline_ns: int) -> None:
        """Serve until the monotonic clock reaches `deadline_ns`, or a signal comes."""
        self._server.run(max(0.0, (deadline_ns - self._clock.monotonic_ns()) * 1e-9))


class PageNode(Node):
    """Serves the page of a rig; each transmission of changes to the pages counts as a step."""

    inputs: ClassVar[tuple[str, ...]] = ()

    def __init__(self, context: NodeContext, hub: Hub, server: PageServer) -> None:
        super().__init__(context)
        self._hub, self._server = hub, server
        hub.on_tick, hub.on_lease = self._count, self._say_who
        self._reported_party: Party | None = None

    def on_message(self, received: Received) -> None:
        """Do nothing: the hub has its own connections."""

    def on_deadline(self, now_ns: int) -> None:
        """Do nothing: the hub keeps its own schedule."""

    def make_safe(self) -> None:
        """End the server, which also releases the hand."""
        self._server.close()
        self._hub.close()

    def _say_who(self, holder: Party | None) -> None:
        """Publish the holder of control, for recordings; omit a party without a name that holds it only for one act."""
        named = holder if holder is not None and (holder.name or self._hub.desk.lease.kept) else None
        if named != self._reported_party:
            self._reported_party = named
            by = {"by": named.name} if named is not None and named.name else {}
            lost = self._hub.desk.lease.lost
            text = f"{named.label} holds control" if named else "control is free"
            if named is None and lost is not None:
                text = f"{lost.text}; {text}"
            self.event("node", "info" if lost is None else "warning", text, role=named.role if named else "", **by)

    def _count(self) -> None:
        self.steps += 1


def page_of_rig(
    participant: Participant,
    site_file: Path,
    bound: Listener,
    access: Access,
    tls: Tls | None,
    recording: RecordingFiles | None = None,
) -> tuple[PageNode, PageBus]:
    """Return the node that serves the page of a rig at a bound address, and its bus.

    `recording`: the files of the rig's recording; None if this process does not know where they are.
    """
    commander = RigCommander(site_file)
    source = LiveSource(participant.book, str(site_file))
    hub = Hub(source, commander, forms, lambda: RigHand(site_file), register=LeaseRegister(), recording=recording)
    server = PageServer(hub, access, bound, tls, participant.wake_descriptor)
    bus = PageBus(
        participant, _publisher_of(participant), server, [*source.subscribers.values(), hub.left_out, hub.desk.refused]
    )
    return PageNode(participant.context(bus), hub, server), bus


def _publisher_of(participant: Participant) -> Publisher:
    """Bind the endpoint of the page; if another page of this rig has bound it, this one publishes no health."""
    try:
        return participant.bind(participant.key)
    except EndpointError as error:
        participant.log.info(f"the page is served without node/health: {error}")
        return NullPublisher(participant.clock, participant.key)
