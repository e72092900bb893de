"""Sessions of WebTransport over HTTP/3, by which datagrams of a page come to the gateway and go back."""

import logging
from typing import Any

from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.asyncio.server import QuicServer, serve
from aioquic.h3.connection import H3_ALPN, H3Connection
from aioquic.h3.events import DatagramReceived, H3Event, HeadersReceived
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import ConnectionTerminated, ProtocolNegotiated, QuicEvent

from telenano.serving import Access, Tls
from telenano_wide_area.gateway.gateway import Gateway, GatewayPage

# A session without a packet for this time is over [s]; a page sends ten probes a second.
_IDLE_S = 5.0
_MOST_DATAGRAM_BYTES = 1200
# Most sessions; a page has one.
_MOST_SESSIONS = 64


class _Session(QuicConnectionProtocol):
    """The connection of one page."""

    gateway: Gateway
    access: Access
    count: set["_Session"]

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._http: H3Connection | None = None
        self._stream = -1
        self._page: GatewayPage | None = None

    def quic_event_received(self, event: QuicEvent) -> None:
        """Take an event of the connection."""
        if isinstance(event, ProtocolNegotiated):
            if len(self.count) >= _MOST_SESSIONS:
                self.close()
                return
            self.count.add(self)
            self._http = H3Connection(self._quic, enable_webtransport=True)
        elif isinstance(event, ConnectionTerminated):
            self.count.discard(self)
            if self._page is not None:
                self._page.send = None
        if self._http is not None:
            for each in self._http.handle_event(event):
                self._take(each)

    def _take(self, event: H3Event) -> None:
        if isinstance(event, HeadersReceived) and self._page is None:
            self._answer(event.stream_id, dict(event.headers))
        elif isinstance(event, DatagramReceived) and self._page is not None and event.stream_id == self._stream:
            self.gateway.from_page(self._page, event.data)

    def _answer(self, stream: int, headers: dict[bytes, bytes]) -> None:
        """Open the session that a page asks for with its ticket, or refuse it."""
        text = {name: value.decode("latin-1") for name, value in headers.items()}
        host = text.get(b":authority", "")
        page = None
        if (
            text.get(b":protocol") == "webtransport"
            and self.access.admits_host(host)
            and self.access.admits_origin(text.get(b"origin", ""), host, encrypted=True)
        ):
            page = self.gateway.open_way(text.get(b":path", ""), self._send)
        assert self._http is not None
        self._page, self._stream = page, stream
        status = b"200" if page is not None else b"403"
        answer = [(b":status", status), (b"sec-webtransport-http3-draft", b"draft02")]
        self._http.send_headers(stream, answer, end_stream=page is None)
        self.transmit()

    def _send(self, frame: bytes) -> None:
        if self._http is not None:
            self._http.send_datagram(self._stream, frame)
            self.transmit()


async def open_sessions(gateway: Gateway, access: Access, tls: Tls, host: str, port: int) -> QuicServer:
    """Listen on a UDP port; OSError if it cannot be bound.

    Args:
        gateway: The gateway whose tickets open a session.
        access: The names of the server, and the origins of its pages.
        tls: Its certificate.
        host: The address.
        port: The port, of the same number as that of the page, because a page may connect to that alone.
    """
    # Any client can cause any number of lines.
    logging.getLogger("quic").setLevel(logging.ERROR)
    configuration = QuicConfiguration(
        alpn_protocols=H3_ALPN, is_client=False, max_datagram_frame_size=_MOST_DATAGRAM_BYTES, idle_timeout=_IDLE_S
    )
    configuration.load_cert_chain(tls.certificate, tls.key)
    members = {"gateway": gateway, "access": access, "count": set[Any]()}
    session = type("Session", (_Session,), members)
    return await serve(host, port, configuration=configuration, create_protocol=session, retry=True)
