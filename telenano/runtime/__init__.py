"""The runtime that all processes share: bus, loop, security, and the start of a node from a command line."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.runtime.bus.address_book import AddressBook as AddressBook
    from telenano.runtime.bus.bus import ConnectionEvent as ConnectionEvent
    from telenano.runtime.bus.bus import Reader as Reader
    from telenano.runtime.bus.bus import Subscriber as Subscriber
    from telenano.runtime.impaired_link import DirectionPath as DirectionPath
    from telenano.runtime.impaired_link import ImpairedLink as ImpairedLink
    from telenano.runtime.impaired_link import SiteEndpoint as SiteEndpoint
    from telenano.runtime.loop.commands import Command as Command
    from telenano.runtime.loop.log import StructuredLog as StructuredLog
    from telenano.runtime.loop.node import NodeContext as NodeContext
    from telenano.runtime.loop.own_process import schedule_as_node as schedule_as_node
    from telenano.runtime.loop.own_process import start_process as start_process
    from telenano.runtime.security.access_control import AccessControl as AccessControl
    from telenano.runtime.security.keyring import KeyPair as KeyPair
    from telenano.runtime.security.keyring import Keyring as Keyring
    from telenano.runtime.wiring.descriptors import check_descriptors as check_descriptors
    from telenano.runtime.wiring.link_transports import TRAIN as TRAIN
    from telenano.runtime.wiring.link_transports import LinkSide as LinkSide
    from telenano.runtime.wiring.link_transports import LinkTransport as LinkTransport
    from telenano.runtime.wiring.main import beside_the_loop as beside_the_loop
    from telenano.runtime.wiring.node_process import NodeProcess as NodeProcess
    from telenano.runtime.wiring.observer import RIG_HINT as RIG_HINT
    from telenano.runtime.wiring.observer import Observer as Observer
    from telenano.runtime.wiring.observer import known_name as known_name
    from telenano.runtime.wiring.participant import Participant as Participant
else:
    __getattr__, __dir__ = face(__name__)
