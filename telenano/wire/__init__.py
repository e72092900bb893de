"""The wire contract: messages, topics and the codec. It imports nothing else of the project.

Each name here is imported on first use: the messages and NumPy take most of the start time of a command, and programs
that cannot wait for them, above all the emergency stop, need only `telenano.wire.nodes` and `telenano.wire.errors`.
"""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.wire.codec import compose as compose
    from telenano.wire.codec import decode as decode
    from telenano.wire.codec import encode as encode
    from telenano.wire.codec import keys_twice as keys_twice
    from telenano.wire.codec import read_header as read_header
    from telenano.wire.errors import ConfigError as ConfigError
    from telenano.wire.errors import EndpointError as EndpointError
    from telenano.wire.errors import NoEstimateError as NoEstimateError
    from telenano.wire.errors import RecordingError as RecordingError
    from telenano.wire.errors import RefusedError as RefusedError
    from telenano.wire.errors import RigError as RigError
    from telenano.wire.errors import TelenanoError as TelenanoError
    from telenano.wire.errors import cause as cause
    from telenano.wire.errors import known_names as known_names
    from telenano.wire.examples import example as example
    from telenano.wire.instrument import AfmProgram as AfmProgram
    from telenano.wire.messages import AfmScanline as AfmScanline
    from telenano.wire.messages import AfmState as AfmState
    from telenano.wire.messages import Array as Array
    from telenano.wire.messages import Count as Count
    from telenano.wire.messages import Facts as Facts
    from telenano.wire.messages import HapticState as HapticState
    from telenano.wire.messages import LawStatus as LawStatus
    from telenano.wire.messages import Lengths as Lengths
    from telenano.wire.messages import LinkClock as LinkClock
    from telenano.wire.messages import LinkDelay as LinkDelay
    from telenano.wire.messages import LinkFate as LinkFate
    from telenano.wire.messages import LinkFates as LinkFates
    from telenano.wire.messages import LinkStatus as LinkStatus
    from telenano.wire.messages import Message as Message
    from telenano.wire.messages import Name as Name
    from telenano.wire.messages import NodeHealth as NodeHealth
    from telenano.wire.messages import Record as Record
    from telenano.wire.messages import Scalar as Scalar
    from telenano.wire.messages import SessionEvent as SessionEvent
    from telenano.wire.messages import TeleopBackward as TeleopBackward
    from telenano.wire.messages import about as about
    from telenano.wire.network_messages import LinkKey as LinkKey
    from telenano.wire.network_messages import LinkNetwork as LinkNetwork
    from telenano.wire.network_messages import RecordingPiece as RecordingPiece
    from telenano.wire.nodes import LINK as LINK
    from telenano.wire.nodes import VIEW as VIEW
    from telenano.wire.printable import one_line as one_line
    from telenano.wire.printable import quoted as quoted
    from telenano.wire.printable import shown as shown
    from telenano.wire.ranges import DurationS as DurationS
    from telenano.wire.ranges import Range as Range
    from telenano.wire.received import Received as Received
    from telenano.wire.refusals import made as made
    from telenano.wire.topics import OWN_TOPICS as OWN_TOPICS
    from telenano.wire.topics import TOPICS as TOPICS
    from telenano.wire.topics import Topic as Topic
else:
    __getattr__, __dir__ = face(__name__)
