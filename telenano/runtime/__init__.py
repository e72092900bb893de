"""What every process shares: bus, clock, loop, health, configuration."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.runtime.bus.address_book import AddressBook as AddressBook
    from telenano.runtime.bus.address_book import load_site as load_site
    from telenano.runtime.datagram.arrivals import SETTLE_NS as SETTLE_NS
    from telenano.runtime.link_node import TRAIN as TRAIN
    from telenano.runtime.link_node import DelayNode as DelayNode
    from telenano.runtime.link_node import DirectionPath as DirectionPath
    from telenano.runtime.link_node import SiteEndpoint as SiteEndpoint
    from telenano.runtime.loop.commands import Command as Command
    from telenano.runtime.loop.log import StructuredLog as StructuredLog
    from telenano.runtime.loop.node import NodeContext as NodeContext
    from telenano.runtime.loop.realtime import apply_realtime as apply_realtime
    from telenano.runtime.wiring.observer import RIG_HINT as RIG_HINT
    from telenano.runtime.wiring.observer import known_name as known_name
    from telenano.runtime.wiring.participant import StopSignals as StopSignals
    from telenano.runtime.wiring.participant import open_participant as open_participant
    from telenano.runtime.wiring.participant import run_loop as run_loop
else:
    __getattr__, __dir__ = face(__name__)
