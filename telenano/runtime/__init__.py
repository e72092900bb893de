"""What every process shares: bus, clock, loop, health, configuration."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.runtime.bus.address_book import AddressBook as AddressBook
    from telenano.runtime.bus.bus import ConnectionEvent as ConnectionEvent
    from telenano.runtime.bus.bus import Subscriber as Subscriber
    from telenano.runtime.bus.publisher import ZmqPublisher as ZmqPublisher
    from telenano.runtime.bus.transports import LinkTransport as LinkTransport
    from telenano.runtime.link_node import TRAIN as TRAIN
    from telenano.runtime.link_node import DelayNode as DelayNode
    from telenano.runtime.link_node import DirectionPath as DirectionPath
    from telenano.runtime.link_node import SiteEndpoint as SiteEndpoint
    from telenano.runtime.loop.commands import Command as Command
    from telenano.runtime.loop.commands import CommandClient as CommandClient
    from telenano.runtime.loop.log import StructuredLog as StructuredLog
    from telenano.runtime.loop.node import NodeContext as NodeContext
    from telenano.runtime.loop.own_process import schedule_as_node as schedule_as_node
    from telenano.runtime.loop.own_process import start_process as start_process
    from telenano.runtime.loop.realtime import apply_realtime as apply_realtime
    from telenano.runtime.security.access_control import AccessControl as AccessControl
    from telenano.runtime.security.keyring import KeyPair as KeyPair
    from telenano.runtime.security.keyring import Keyring as Keyring
    from telenano.runtime.wiring.link_transports import FetchRecording as FetchRecording
    from telenano.runtime.wiring.link_transports import OpenEnds as OpenEnds
    from telenano.runtime.wiring.link_transports import SendsPieces as SendsPieces
    from telenano.runtime.wiring.main import beside_the_loop as beside_the_loop
    from telenano.runtime.wiring.main import run_beside as run_beside
    from telenano.runtime.wiring.observer import RIG_HINT as RIG_HINT
    from telenano.runtime.wiring.observer import Observer as Observer
    from telenano.runtime.wiring.observer import known_name as known_name
    from telenano.runtime.wiring.participant import LinkEnds as LinkEnds
    from telenano.runtime.wiring.participant import Participant as Participant
    from telenano.runtime.wiring.participant import StopSignals as StopSignals
    from telenano.runtime.wiring.transport import Transport as Transport
else:
    __getattr__, __dir__ = face(__name__)
