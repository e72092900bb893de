"""The requests that a page may send to the server: one msgpack map per frame, checked before it is used."""

import math
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from telenano.serving.serve import LARGEST_FRAME
from telenano.wire.messages import Scalar

# Version of the protocol; it increases when a page and a server of different builds would misread each other.
PROTOCOL = 1
Name = Literal["start", "stop", "arm", "set", "mark", "couple"]
COMMANDS: tuple[Name, ...] = get_args(Name)
_Id = Annotated[str, Meta(pattern="^[A-Za-z0-9_-]{1,64}\\Z")]
_Text = Annotated[str, Meta(max_length=256)]
_Number = Annotated[int, Meta(ge=0, le=2**53)]
_Integer = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
_Values = Annotated[dict[str, bool | _Integer | float | Annotated[str, Meta(max_length=4096)]], Meta(max_length=64)]


class RequestError(Exception):
    """A frame is no valid request; the text says what would be valid."""


class _Frame(msgspec.Struct, frozen=True, tag_field="k"):
    """A frame, with its kind as the key `k`; a float that is not finite is refused."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value: Scalar | dict[str, Scalar] = getattr(self, name)
            parameters = (
                {f"{name}.{key}": each for key, each in value.items()} if isinstance(value, dict) else {name: value}
            )
            if wrong := [
                key for key, each in parameters.items() if isinstance(each, float) and not math.isfinite(each)
            ]:
                raise ValueError(f"{wrong[0][:80]}: must be a finite number")


class Hello(_Frame, tag="hello", frozen=True):
    """The first frame of a page: its token and the protocol that it was built for."""

    token: _Text
    protocol: int


class CommandRequest(_Frame, tag="command", frozen=True):
    """A command to the nodes of the rig."""

    id: _Id
    command: Name
    target: _Text
    parameters: _Values = {}
    # Number of the lease of control under which the command was given; 0 if the page knows none.
    lease: _Number = 0


class EstopRequest(_Frame, tag="estop", frozen=True):
    """An emergency stop."""

    id: _Id


class TransportRequest(_Frame, tag="transport", frozen=True):
    """An action of the transport of a recording; `value` is a place [s] or a rate."""

    id: _Id
    action: _Text
    value: float


class DocumentRequest(_Frame, tag="document", frozen=True):
    """A request for the facts of a whole recording."""

    id: _Id


class PartRequest(_Frame, tag="part", frozen=True):
    """A request for the curves of a part of a recording [s], in this number of spans; 0 requests every sample."""

    id: _Id
    from_s: float
    to_s: float
    spans: int


class RecordingRequest(_Frame, tag="recording", frozen=True):
    """A request for the list of the recording's files, or for an address from which to download one; `name` is its."""

    id: _Id
    name: _Text = ""


class HandRequest(_Frame, tag="hand", frozen=True):
    """The force of the operator at the page [N], towards the sample; `held` is false when the hand is released.

    across_x_n, across_y_n: force across the sample [N]; 0 from a page that only presses. number: number of the frame,
    from 1; stamp_s: time of sending by the page's clock [s]; both are 0 if the page does not state them.
    """

    force_n: float
    held: bool = False
    across_x_n: float = 0.0
    across_y_n: float = 0.0
    lease: _Number = 0
    number: _Number = 0
    stamp_s: float = 0.0


class LeaseRequest(_Frame, tag="lease", frozen=True):
    """A request for the lease of control; `to` is the id of the party to which `hand_over` gives it."""

    id: _Id
    action: Literal["ask", "take", "hand_over", "let_go"]
    to: _Text = ""
    lease: _Number = 0


class HereRequest(_Frame, tag="here", frozen=True):
    """A sign that the page is there: a holder of control that is silent for a second loses it.

    `stamp_s`: time stamp of the frame `way` that this answers; `waited_s`: time that the frame spent at the page [s].
    """

    stamp_s: float = 0.0
    waited_s: float = 0.0


class PanelRequest(_Frame, tag="panel", frozen=True):
    """A request to the part of a package's panel that runs in the server."""

    id: _Id
    panel: _Text
    values: _Values = {}


Request = (
    Hello
    | CommandRequest
    | EstopRequest
    | TransportRequest
    | HandRequest
    | DocumentRequest
    | PartRequest
    | RecordingRequest
    | PanelRequest
    | LeaseRequest
    | HereRequest
)
_decoder: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)


def read_request(frame: bytes) -> Request:
    """Return the request in a frame; raise RequestError if it is too long or no valid request."""
    if len(frame) > LARGEST_FRAME:
        raise RequestError(f"a frame has {len(frame)} bytes, {LARGEST_FRAME} are allowed")
    try:
        return _decoder.decode(frame)
    except msgspec.ValidationError as error:
        raise RequestError(f"a frame is not what a page may send: {error}") from error
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise RequestError("a frame is not one msgpack map") from error
