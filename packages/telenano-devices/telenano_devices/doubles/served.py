"""Runs the emulated Inverse Service on a port of its own, in a thread of a test."""

import asyncio
import threading

from telenano_devices.haply.haply import ARM
from telenano_devices.haply.haply_service import HaplyService, serve_haply
from telenano_devices.impedance.emulated_arm import EmulatedArm, hand_of


class ServedPort:
    """A service on a port of its own, in a thread."""

    def __init__(self) -> None:
        self.service = HaplyService(EmulatedArm(hand_of(), ARM))
        self.port = 0
        self._ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        assert self._ready.wait(20.0)

    def _run(self) -> None:
        def ready(port: int) -> None:
            self.port = port
            self._ready.set()

        async def serve() -> None:
            self._task = asyncio.current_task()
            await serve_haply(self.service, "127.0.0.1", 0, ready)

        try:
            self._loop.run_until_complete(serve())
        except asyncio.CancelledError:
            pass
        finally:
            self._loop.close()

    @property
    def address(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    def close(self) -> None:
        if self._task is not None:
            self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join()
