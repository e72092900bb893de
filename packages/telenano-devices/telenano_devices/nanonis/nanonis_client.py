"""A blocking client of Nanonis, for scripts, and for an approach before a rig drives the external input."""

import math
import socket
import time
from typing import Any

from telenano.extend.instruments import DeviceError
from telenano_devices.controllers.request_answer import Incoming, WireError
from telenano_devices.nanonis import nanonis_wire
from telenano_devices.nanonis.nanonis_wire import NanonisRefusalError

_READ_BYTES = 65536
_POLL_S = 0.05
# Time limit of an answer.
_ANSWER_S = 5.0
# Time limit for z to come to rest, and for the z-controller to switch off.
_REST_WITHIN_S = 60.0
# z is at rest when it moves by less than _REST_M over this number of looks.
_RESTS = 6
# An approach moves further than this between the looks.
_REST_M = 2e-9


class NanonisClient:
    """A connection for one call after the other; a broken connection is closed and cannot be used again.

    Args:
        host: The address of the controller.
        port: One of its ports.

    Raises:
        DeviceError: The controller cannot be reached.
    """

    def __init__(self, host: str, port: int) -> None:
        self._where = f"{host}:{port}"
        try:
            self._line = socket.create_connection((host, port), timeout=_ANSWER_S)
        except OSError as error:
            raise DeviceError(f"{self._where}: cannot be reached: {error.strerror or error}") from error
        self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._incoming = Incoming(nanonis_wire.cut)

    def call(self, command: str, *arguments: Any) -> list[Any]:
        """Return the values of the answer to a command of `nanonis_wire.COMMANDS`.

        Raises:
            DeviceError: The controller refuses it, does not answer in time, or its answer cannot be read.
        """
        try:
            end_s = time.monotonic() + _ANSWER_S
            self._line.sendall(nanonis_wire.request(command, *arguments))
            while (answer := self._incoming.take()) is None:
                # The timeout of the socket limits each part of an answer; this limits the whole answer.
                if time.monotonic() > end_s:
                    raise TimeoutError("timed out")
                received = self._line.recv(_READ_BYTES)
                if not received:
                    raise OSError("it has closed the connection")
                self._incoming.add(received)
            return nanonis_wire.returned(command, answer)
        except NanonisRefusalError as error:
            raise DeviceError(f"{self._where}: refuses {command}{arguments or ''}: {error}") from None
        except (OSError, WireError) as error:
            self.close()
            raise DeviceError(f"{self._where}: {command}: {error.strerror or error}") from error  # type: ignore[union-attr]

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def now_s(self) -> float:
        return time.monotonic()

    def close(self) -> None:
        self._line.close()


def _settle(client: NanonisClient, setpoint: float) -> None:
    """Switch the z-controller on, and wait until z is at rest; raise DeviceError if that takes too long."""
    client.call("ZCtrl.SetpntSet", setpoint)
    client.call("ZCtrl.OnOffSet", 1)
    end, past = client.now_s() + _REST_WITHIN_S, [math.inf]
    while len(past) < _RESTS or max(past[-_RESTS:]) - min(past[-_RESTS:]) > _REST_M:
        if client.now_s() > end:
            raise DeviceError(f"z did not come to rest within {_REST_WITHIN_S:g} s: is the surface within its range?")
        client.sleep(_POLL_S)
        past.append(client.call("ZCtrl.ZPosGet")[0])


def approach(client: NanonisClient, setpoint: float, lift_m: float) -> float:
    """Approach with the controller's z-controller, switch it off with a lift of the tip, and return z then [m].

    The tip stays there, for a rig that drives the external input of the controller.

    Args:
        client: The connection.
        setpoint: The set-point, in the unit of the controller's signal.
        lift_m: The lift of the tip [m].

    Raises:
        DeviceError: The controller refuses or finds no surface; the tip is then withdrawn.
    """
    try:
        client.call("ZCtrl.TipLiftSet", lift_m)
        _settle(client, setpoint)
        client.call("ZCtrl.OnOffSet", 0)
        end = client.now_s() + _REST_WITHIN_S
        while client.call("ZCtrl.OnOffGet")[0]:
            if client.now_s() > end:
                raise DeviceError(f"the z-controller was not off within {_REST_WITHIN_S:g} s")
            client.sleep(_POLL_S)
        return float(client.call("ZCtrl.ZPosGet")[0])
    except DeviceError:
        client.call("ZCtrl.Withdraw", 0, -1)
        raise
