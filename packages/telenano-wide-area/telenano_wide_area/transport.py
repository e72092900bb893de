"""What this package declares of its transport; it loads nothing that an end needs."""

from telenano.runtime import LinkTransport
from telenano_wide_area.settings import DatagramSettings

DATAGRAM = LinkTransport(
    DatagramSettings,
    ends="telenano_wide_area.link_end:open_ends",
    beside="telenano_wide_area.relay",
    sender="telenano_wide_area.piece_sender:PieceSender",
    fetch="telenano_wide_area.far_recording:fetch_and_merge",
)
