"""The emulator of Nanonis on real sockets: our client, and the vendor's own where it is installed, read the same."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from telenano_devices.controllers.request_server import PushedStream, serve_requests
from telenano_devices.nanonis import nanonis_model, nanonis_wire
from telenano_devices.nanonis.nanonis_client import NanonisClient

from telenano.extend.instruments import DeviceError
from telenano.testing import PATIENCE_S, free_ports, instrument_of, until


class Served:
    """The emulator on free ports, in a thread of its own."""

    def __init__(self, section: dict[str, Any]) -> None:
        afm = instrument_of(section)
        afm.open()
        self.model = nanonis_model.NanonisModel(afm, now_ns=time.monotonic_ns())
        self.ports = free_ports(3)
        self._ready, self._loop = threading.Event(), asyncio.new_event_loop()
        pushed = PushedStream(self.ports[2], self.model.log.take)
        self._task = self._loop.create_task(
            serve_requests(
                nanonis_wire.cut,
                self.model.serve,
                self.model.pass_time,
                "127.0.0.1",
                self.ports[:2],
                self._ready.set,
                1,
                pushed,
            )
        )
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        assert self._ready.wait(PATIENCE_S)

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._task)
        except asyncio.CancelledError:
            pass
        finally:
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())
            self._loop.close()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(PATIENCE_S)


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    sample = {"sample": {"name": "grating"}, "cantilever": {"stiffness_n_per_m": 1.0}}
    found = Served(sample)
    yield found
    found.close()


def test_our_client_calls_refuses_and_takes_frames_of_the_logger(served: Served) -> None:
    client = NanonisClient("127.0.0.1", served.ports[0])
    try:
        assert client.call("ZCtrl.StatusGet") == [1]
        with pytest.raises(DeviceError, match=r"refuses ZCtrl.LimitsSet.*is not enabled yet"):
            client.call("ZCtrl.LimitsSet", 1e-7, -1e-7)
        with socket.create_connection(("127.0.0.1", served.ports[2]), timeout=PATIENCE_S) as logger:
            client.call("TCPLog.ChsSet", [nanonis_model.Z, nanonis_model.X])
            client.call("TCPLog.Start")
            received = b""
            while len(received) < 10 * 26:
                received += logger.recv(4096)
            # the first frame is the list of the columns
            first = nanonis_model._LOG_HEADER.unpack_from(received)
            assert (first[0], first[3]) == (2, 2)
            assert np.frombuffer(received[18:26], ">f4").tolist() == [nanonis_model.Z, nanonis_model.X]
            counters = [nanonis_model._LOG_HEADER.unpack_from(received, 26 * n)[2] for n in range(1, 10)]
            assert counters == list(range(counters[0], counters[0] + 9))
    finally:
        client.close()
    with pytest.raises(DeviceError, match="cannot be reached"):
        NanonisClient("127.0.0.1", *free_ports(1))


def test_a_second_client_at_a_port_is_put_out(served: Served) -> None:
    first = NanonisClient("127.0.0.1", served.ports[0])
    assert first.call("ZCtrl.StatusGet") == [1]
    second = NanonisClient("127.0.0.1", served.ports[0])
    with pytest.raises(DeviceError, match=r"closed the connection|reset by peer|Broken pipe"):
        second.call("ZCtrl.StatusGet")
    assert first.call("ZCtrl.StatusGet") == [1]
    first.close()


def test_the_vendors_client_and_ours_read_the_same(served: Served) -> None:
    """Its own test set: lists, matrices, texts, an error, and the values that both read."""
    vendor = pytest.importorskip("nanonis_spm", reason="the vendor's client is not installed: pip install nanonis-spm")
    ours = NanonisClient("127.0.0.1", served.ports[0])
    line = socket.create_connection(("127.0.0.1", served.ports[1]), timeout=PATIENCE_S)
    theirs = vendor.Nanonis(line)

    def read(function: str, *arguments: Any) -> list[Any]:
        error, _, values = getattr(theirs, function)(*arguments)
        assert error == ""
        return list(values)

    try:
        names = read("Signals_NamesGet")[-1]
        assert list(names) == ours.call("Signals.NamesGet")[0]
        read("ZCtrl_ZPosSet", 2.5e-7)
        assert ours.call("ZCtrl.ZPosGet") == read("ZCtrl_ZPosGet") == [pytest.approx(2.5e-7)]
        assert read("ZCtrl_StatusGet") == ours.call("ZCtrl.StatusGet")
        ours.call("SafeTip.PropsSet", 0, 0, 0.25)
        assert read("SafeTip_PropsGet") == ours.call("SafeTip.PropsGet") == [0, 0, 0.25]
        read("FolMe_XYPosSet", 1e-8, -2e-8, 0)
        until(lambda: ours.call("FolMe.XYPosGet", 1) == [1e-8, -2e-8])
        assert read("FolMe_XYPosGet", 1) == [1e-8, -2e-8]
        indexes = [nanonis_model.Z, nanonis_model.X, nanonis_model.Y]
        assert np.ravel(read("Signals_ValsGet", indexes, 1)[-1]).tolist() == ours.call("Signals.ValsGet", indexes, 1)[0]
        read("Scan_BufferSet", [nanonis_model.Z], 32, 2)
        ours.call("Scan.SpeedSet", 1e-6, 1e-6, 0.05, 0.05, 2, 1.0)
        read("Scan_Action", 0, 1)
        until(lambda: ours.call("Scan.StatusGet") == [0])
        frame = read("Scan_FrameDataGrab", nanonis_model.Z, 1)
        name, found, up = ours.call("Scan.FrameDataGrab", nanonis_model.Z, 1)
        assert name in frame
        matrix = next(value for value in frame if isinstance(value, np.ndarray) and value.ndim == 2)
        np.testing.assert_array_equal(matrix, found)
        assert frame[-1] == up
        error, *_ = theirs.ZCtrl_LimitsSet(1e-7, -1e-7)
        assert "is not enabled yet" in str(error)
    finally:
        ours.close()
        line.close()
