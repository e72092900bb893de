"""What a page may say to the server: one msgpack map a frame, checked before anything is done with it."""

import math
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from telenano.serving.serve import LARGEST_FRAME
from telenano.wire.messages import Scalar

# raised when a page of an older build would misread what the server says, or the other way round
PROTOCOL = 1
Name = Literal["start", "stop", "arm", "set", "mark", "couple"]
COMMANDS: tuple[Name, ...] = get_args(Name)
_Id = Annotated[str, Meta(pattern="^[A-Za-z0-9_-]{1,64}\\Z")]
_Text = Annotated[str, Meta(max_length=256)]
_Number = Annotated[int, Meta(ge=0, le=2**53)]
_Integer = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
_Values = Annotated[dict[str, bool | _Integer | float | Annotated[str, Meta(max_length=4096)]], Meta(max_length=64)]


class RequestError(Exception):
    """A frame is not what a page may send; the text says what would be right."""


class _Frame(msgspec.Struct, frozen=True, tag_field="k"):
    """A frame, whose key `k` says which."""

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
    # number of the lease of the hand under which it was given; 0 where the page has none
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
    """A question for what happened in the whole of a recording."""

    id: _Id


class PartRequest(_Frame, tag="part", frozen=True):
    """A question for the curves of a part of a recording [s], in this number of spans; every sample for 0."""

    id: _Id
    from_s: float
    to_s: float
    spans: int


class HandRequest(_Frame, tag="hand", frozen=True):
    """The force of the operator at the page [N], towards the sample; `held` is false when the hand lets go.

    across_x_n, across_y_n: that across the sample [N]; none from a page that only presses. number, stamp_s: of the
    frame, counted from 1, and when it was sent, by the page's clock [s]; 0 from one that does not say.
    """

    force_n: float
    held: bool = False
    across_x_n: float = 0.0
    across_y_n: float = 0.0
    lease: _Number = 0
    number: _Number = 0
    stamp_s: float = 0.0


class LeaseRequest(_Frame, tag="lease", frozen=True):
    """What a page wants of the lease of the hand; `to` is the id of one who asks, for whom it is."""

    id: _Id
    action: Literal["ask", "take", "hand_over", "let_go"]
    to: _Text = ""
    lease: _Number = 0


class HereRequest(_Frame, tag="here", frozen=True):
    """A page is there: who has the hand and says nothing for a second has lost it.

    `stamp_s`: of the frame `way` that it answers, `waited_s`: for how long that was at the page [s].
    """

    stamp_s: float = 0.0
    waited_s: float = 0.0


class PanelRequest(_Frame, tag="panel", frozen=True):
    """What a page asks of the half of a package's panel that runs in the server."""

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
    | PanelRequest
    | LeaseRequest
    | HereRequest
)
_decoder: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)


def read_request(frame: bytes) -> Request:
    """Read a frame; RequestError says what is wrong with it."""
    if len(frame) > LARGEST_FRAME:
        raise RequestError(f"a frame has {len(frame)} bytes, {LARGEST_FRAME} are allowed")
    try:
        return _decoder.decode(frame)
    except msgspec.ValidationError as error:
        raise RequestError(f"a frame is not what a page may send: {error}") from error
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise RequestError("a frame is not one msgpack map") from error
