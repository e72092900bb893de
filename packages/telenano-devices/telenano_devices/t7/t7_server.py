"""Serves the T7 model by a Modbus TCP server of pymodbus, in a process of its own like a device on the network."""

import asyncio
import contextlib
import time
from collections.abc import Callable

from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
)
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from telenano.devices import FeedbackRequest
from telenano_devices.t7.t7_model import RegisterError, T7Model

# The step of a script on the device.
_WATCH_S = 0.005


def served_requests(serve: Callable[[ModbusPDU], ModbusPDU]) -> list[type[ModbusPDU]]:
    """Return the classes of requests that the device knows, each answered by `serve`."""

    async def update(request: ModbusPDU, context: object, device_id: int) -> ModbusPDU:
        return serve(request)

    kinds = (ReadHoldingRegistersRequest, WriteMultipleRegistersRequest, FeedbackRequest)
    return [type(kind.__name__, (kind,), {"datastore_update": update}) for kind in kinds]


def respond(model: T7Model, request: ModbusPDU, now_ns: int) -> ModbusPDU:
    """Return the answer of the device, which may be a Modbus exception."""
    try:
        if isinstance(request, FeedbackRequest):
            return request.answered(model.feedback(request, now_ns))
        if isinstance(request, WriteMultipleRegistersRequest):
            model.write(request.address, list(request.registers), now_ns)
            return WriteMultipleRegistersResponse(address=request.address, count=len(request.registers))
        return ReadHoldingRegistersResponse(registers=model.read(request.address, request.count, now_ns))
    except RegisterError as error:
        return ExceptionResponse(request.function_code, error.code)


async def serve_t7(
    model: T7Model, host: str, port: int, latency_s: float, on_ready: Callable[[], None] = lambda: None
) -> None:
    """Serve the model until the task is cancelled.

    Args:
        model: The device to serve.
        host: The address to listen at.
        port: The TCP port to listen at.
        latency_s: The time that the device takes for a request [s], as a T7 on Ethernet does.
        on_ready: The function that is called once the port is bound.

    Raises:
        OSError: The address cannot be bound.
    """

    def serve(request: ModbusPDU) -> ModbusPDU:
        # The timers of asyncio have steps of a millisecond, and the device does nothing else meanwhile.
        time.sleep(latency_s)
        return respond(model, request, time.monotonic_ns())

    # The registers of the model are not in pymodbus' own store, which needs at least one register.
    store = SimDevice(id=0, simdata=[SimData(0, values=0, datatype=DataType.REGISTERS)])
    server = ModbusTcpServer(store, address=(host, port), custom_pdu=served_requests(serve))
    await server.serve_forever(background=True)
    on_ready()
    try:
        await _watch(model)
    finally:
        with contextlib.suppress(asyncio.CancelledError):
            await server.shutdown()  # type: ignore[no-untyped-call]


async def _watch(model: T7Model) -> None:
    while True:
        await asyncio.sleep(_WATCH_S)
        model.pass_time(time.monotonic_ns())
