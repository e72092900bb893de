"""Loaded by every Python of a site whose PYTHONPATH has this folder: makes its half of the law a liar with a key.

Beside each datagram that it sends there is one of `fuzz_datagrams`, and beside each message over TCP an extreme or a
broken one of `telenano.testing.Frames`, in the name and with the key of its machine.
"""

import sys

if "services.controller" in sys.orig_argv:
    import time

    from telenano_wide_area.datagram.body import DATAGRAMS_OF
    from telenano_wide_area.datagram.end import DatagramEnd
    from telenano_wide_area.doubles.fuzz_datagrams import Datagrams

    from telenano.runtime.bus.publisher import ZmqPublisher
    from telenano.testing.frames import Frames, stream
    from telenano.wire.topics import OWN_TOPICS as TOPICS

    # A frame for so many messages: the link's bytes are counted, and what is genuine should still get through.
    ONE_IN = 8
    made = Datagrams("live", time.time_ns(), DATAGRAMS_OF["backward"])
    frames = stream(Frames("live", time.time_ns(), gentle=True), list(TOPICS), sys.maxsize)
    honest_send, honest_publish = DatagramEnd._send, ZmqPublisher.send
    count = 0

    def _send(end: DatagramEnd, samples: bytes, now_ns: int) -> None:
        honest_send(end, samples, now_ns)
        sealer, peer = end._agreement.sealer, end._peer
        if sealer is not None and peer is not None and made.random.random() < 1.0 / ONE_IN:
            end.socket.sendto(made.sealed(sealer, end._clock.now_ns()), peer)

    def send(publisher: ZmqPublisher, topic: str, payload: bytes) -> None:
        global count
        honest_publish(publisher, topic, payload)
        count += 1
        if count % ONE_IN == 0 and (parts := next(frames)):
            publisher.socket.send_multipart(parts)

    DatagramEnd._send, ZmqPublisher.send = _send, send  # type: ignore[method-assign]
