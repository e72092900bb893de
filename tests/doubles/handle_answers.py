"""The payloads of a handle's answers, packed as by its firmware."""

from telenano.devices.hand import wire


def pack_hello(hello: wire.HandleHello) -> bytes:
    """Return the payload of HELLO."""
    *numbers, model = hello
    return wire._HELLO.pack(wire.HELLO, *numbers, 0, model.encode())


def pack_state(state: wire.HandleState) -> bytes:
    """Return the payload of STATE."""
    return wire._STATE.pack(wire.STATE, *state)


def pack_configured(answer: wire.ConfigAnswer) -> bytes:
    """Return the payload that answers CONFIG."""
    return wire._CONFIG.pack(wire.CONFIGURED, 0, answer.seq, answer.session, *answer.limits)


def pack_fault(fault: wire.DeviceFault) -> bytes:
    """Return the payload of FAULT."""
    return wire._FAULT.pack(wire.FAULT, 0, fault.seq, fault.code, fault.severity, fault.text.encode())
