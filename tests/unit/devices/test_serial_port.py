"""A real serial port (a pseudo-terminal): what it refuses, that it never waits, and a handle at its other end."""

import contextlib
import fcntl
import os
import select
import shutil
import struct
import termios
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from telenano.devices.hand.port import SerialPort, holder_of
from telenano.extend.hands import DeviceError
from telenano.sections.hand_section import HapticConfig, LimitsConfig

# of Linux: the exclusive mark of a terminal
TIOCGEXCL = 0x80045440


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    yield master, name
    # a test may have pulled it out
    with contextlib.suppress(OSError):
        os.close(master)


def test_bytes_go_both_ways_without_waiting(pty: tuple[int, str]) -> None:
    master, name = pty
    port = SerialPort(name, 1_000_000)
    assert port.read() == b""
    os.write(master, b"\x01\x02\x00")
    # The kernel hands the line over some time later.
    assert select.select([port._descriptor], [], [], 10.0)[0]
    assert port.read() == b"\x01\x02\x00"
    assert port.write(b"\x03\x00")
    assert os.read(master, 10) == b"\x03\x00"
    port.close()
    port.close()


def test_full_buffer_drops_the_frame_and_the_next_begins_behind_a_zero(pty: tuple[int, str]) -> None:
    master, name = pty
    port = SerialPort(name, 1_000_000)
    frame = b"\x11" * 199 + b"\0"
    taken = 0
    while port.write(frame):
        taken += 1
        assert taken < 10_000
    got = b""
    while len(got) < taken * len(frame):
        got += os.read(master, 65536)
    os.set_blocking(master, False)
    with contextlib.suppress(BlockingIOError):
        got += os.read(master, 65536)
    assert port.write(b"\x22\0")
    assert select.select([master], [], [], 10.0)[0]
    got += os.read(master, 65536)
    *frames, _ = got.split(b"\0")
    assert frames[-1] == b"\x22"
    port.close()


def test_pulled_cable_is_a_device_error_at_the_next_read_and_write(pty: tuple[int, str]) -> None:
    master, name = pty
    port = SerialPort(name, 1_000_000)
    os.close(master)
    with pytest.raises(DeviceError, match="the device is gone"):
        port.read()
    with pytest.raises(DeviceError, match="the device is gone"):
        port.write(b"\x01\0")
    port.close()


def test_port_that_is_held_missing_or_no_port_is_refused_in_a_sentence(pty: tuple[int, str], tmp_path: Path) -> None:
    _, name = pty
    port = SerialPort(name, 1_000_000)
    with pytest.raises(DeviceError, match="is in use"):
        SerialPort(name, 1_000_000)
    port.close()
    with pytest.raises(DeviceError, match=r"there is no such port; `telenano device list`"):
        SerialPort(str(tmp_path / "none"), 1_000_000)
    (tmp_path / "file").touch()
    with pytest.raises(DeviceError, match="cannot be opened as a serial port"):
        SerialPort(str(tmp_path / "file"), 1_000_000)


def is_exclusive(descriptor: int) -> bool:
    return bool(struct.unpack("i", fcntl.ioctl(descriptor, TIOCGEXCL, struct.pack("i", 0)))[0])


def test_port_is_free_again_once_it_is_closed_although_another_has_it_open(pty: tuple[int, str]) -> None:
    _, name = pty
    other = os.open(name, os.O_RDWR | os.O_NOCTTY)
    port = SerialPort(name, 1_000_000)
    # root may open it all the same, nobody else
    assert is_exclusive(other)
    port.close()
    assert not is_exclusive(other)
    os.close(other)


def test_holder_of_a_port_is_named(tmp_path: Path) -> None:
    device = tmp_path / "ttyX"
    device.touch()
    (tmp_path / "proc/4242/fd").mkdir(parents=True)
    (tmp_path / "proc/4242/comm").write_text("minicom\n")
    (tmp_path / "proc/4242/fd/3").symlink_to(device)
    (tmp_path / "proc/version").touch()
    assert holder_of(str(device), tmp_path / "proc") == "minicom (4242)"
    assert holder_of(str(tmp_path / "ttyY"), tmp_path / "proc") == ""


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt install gcc libc6-dev")
def test_handle_on_a_port_is_found_pulled_out_and_found_again(tmp_path: Path) -> None:
    from telenano_devices.handle.emulated_handle import EmulatedHandle
    from telenano_devices.handle.handle_on_pty import HandleOnPty

    from telenano.devices.hand.serial_driver import SerialHandle

    link = tmp_path / "by-id/handle"
    port = HandleOnPty(EmulatedHandle(HapticConfig(), session=7), link)
    running = threading.Event()
    running.set()
    thread = threading.Thread(target=lambda: port.run(running.is_set))
    thread.start()
    try:
        driver = SerialHandle(str(link), 1_000_000, None, LimitsConfig())
        until = time.monotonic() + 120.0
        while driver.hello is None:
            # a machine that is busy may hold the board up for longer than the three seconds of the handshake
            with contextlib.suppress(DeviceError):
                driver.identify()
            assert time.monotonic() < until
        assert driver.hello.model == "telenano posix"
        driver.close()
        # a host that was killed leaves its mark, which a board that is unplugged by nobody would keep
        killed = os.open(link, os.O_RDWR | os.O_NOCTTY)
        fcntl.ioctl(killed, termios.TIOCEXCL)
        while is_exclusive(killed):
            assert time.monotonic() < until
            time.sleep(0.01)
        os.close(killed)
    finally:
        running.clear()
        thread.join()
    port.pull_out()
    assert not link.is_symlink()
    with pytest.raises(DeviceError, match="there is no such port"):
        SerialHandle(str(link), 1_000_000, None, LimitsConfig()).identify()
    port.plug_in()
    assert link.is_symlink()
    port.pull_out()
