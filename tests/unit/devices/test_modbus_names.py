"""An instrument by name: no tick waits for a name server; and answers that are not to what was asked."""

import logging
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from telenano_devices.t7.stage_line import PARAMS, StageLine, calibration

from telenano.devices.afm.host_address import HostAddress
from telenano.devices.afm.modbus_driver import ModbusAfm
from telenano.devices.afm.modbus_line import NAME_NS, STEP_NS, TcpConnector
from telenano.devices.afm.register_map import read_map
from telenano.extend.instruments import DeviceError

MS = 1_000_000

NAME = "instrument.test"
ANSWER = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", 502))]


class NameServer:
    """Stands for getaddrinfo: digits it reads itself, a name it asks a server for that may not answer."""

    def __init__(self) -> None:
        self.answers = threading.Event()
        self.result: Any = ANSWER
        self.asked_by: list[threading.Thread] = []
        self._real = socket.getaddrinfo

    def __call__(self, host: Any, port: Any, *arguments: Any, flags: int = 0, **options: Any) -> Any:
        if host != NAME or flags & socket.AI_NUMERICHOST:
            return self._real(host, port, *arguments, flags=flags, **options)
        self.asked_by.append(threading.current_thread())
        # an end of its own, for a loop that does wait; the test then fails and does not hang
        self.answers.wait(10.0)
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> Iterator[NameServer]:
    made = NameServer()
    monkeypatch.setattr(socket, "getaddrinfo", made)
    yield made
    made.answers.set()


class Clock:
    """Time that passes only when the driver sleeps; `meanwhile` is done then."""

    def __init__(self) -> None:
        self.now_ns = 10**9
        self.meanwhile: Callable[[], None] = lambda: None

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)
        self.meanwhile()


def named_driver(clock: Clock, connector: TcpConnector | None = None) -> ModbusAfm:
    return ModbusAfm(
        calibration(network={"host": NAME, "port": 502}),
        read_map("t7"),
        PARAMS.safety,
        now_ns=lambda: clock.now_ns,
        sleep=clock.sleep,
        connect=connector,
    )


def test_no_tick_asks_a_name_server(names: NameServer) -> None:
    clock = Clock()
    driver = named_driver(clock)
    # as in a session whose network has gone: the driver is open, and connects anew every half second
    driver._opened = True
    for _ in range(3000):
        clock.now_ns += MS
        driver.exchange(PARAMS.safety.retract_position_m)
        assert driver.report.status == "lost"
    assert len(names.asked_by) <= 1
    assert threading.main_thread() not in names.asked_by
    assert not names.answers.is_set()
    # nor does the retraction at the end
    driver.retract()
    driver.close()
    assert threading.main_thread() not in names.asked_by


def test_an_opening_waits_for_a_name_server_for_a_while_and_names_the_remedy(names: NameServer) -> None:
    clock = Clock()
    with pytest.raises(DeviceError, match=r"no name server answers: set network\.host to its address"):
        named_driver(clock).open()
    assert NAME_NS < clock.now_ns - 10**9 < NAME_NS + STEP_NS


def test_a_name_that_nobody_knows_is_a_sentence(names: NameServer) -> None:
    names.result = socket.gaierror(socket.EAI_NONAME, "Name or service not known")
    names.answers.set()
    clock, connector = Clock(), TcpConnector()
    # the answer comes while the driver sleeps, however busy the machine is
    clock.meanwhile = lambda: settled(*connector._places.values())
    with pytest.raises(DeviceError, match=f"{NAME}:502: .*: its name is not known: Name or service not known"):
        named_driver(clock, connector).open()


def settled(*places: HostAddress) -> None:
    while any(place._under_way for place in places):
        threading.Event().wait(0.001)


def test_the_last_address_counts_until_there_is_a_newer_one() -> None:
    found: list[Any] = [ANSWER, OSError("no route to the name server"), [(2, 1, 6, "", ("127.0.0.9", 502))]]

    def look_up(host: str, port: int) -> list[Any]:
        result = found.pop(0)
        if isinstance(result, Exception):
            raise result
        return list(result)

    place = HostAddress(NAME, 502, look_up)
    seen = []
    for _ in range(3):
        settled(place)
        address = place.poll()
        assert address is not None
        seen.append(address.address[0])
        if found:
            place.renew()
    assert seen == ["127.0.0.1", "127.0.0.1", "127.0.0.9"]


def test_an_address_in_digits_is_known_at_once_and_nobody_is_asked(names: NameServer) -> None:
    for digits in ("127.0.0.1", "::1"):
        place = HostAddress(digits, 502)
        found = place.poll()
        assert found is not None
        assert found.address[0] == digits
    assert names.asked_by == []


# --- answers that are not to what was asked ---


def unit_changed(sent: bytes) -> bytes:
    return sent[:6] + bytes([sent[6] ^ 5]) + sent[7:]


def function_changed(sent: bytes) -> bytes:
    # to function 3, with as many registers as there are
    words = sent[8:]
    return sent[:4] + (3 + len(words)).to_bytes(2, "big") + sent[6:7] + bytes([3, len(words)]) + words


def exception_of_another_function(sent: bytes) -> bytes:
    return sent[:4] + b"\0\x03" + sent[6:7] + bytes([0x80 | 16, 2])


@pytest.mark.parametrize("change", [unit_changed, function_changed, exception_of_another_function])
def test_an_answer_of_another_unit_or_function_is_refused_and_counted(change: Any) -> None:
    line = StageLine()
    line.driver.open()
    for _ in range(20):
        line.pass_ms(1)
        genuine = line.driver.exchange(PARAMS.safety.retract_position_m)
    taken = line.driver.exchanges
    # beside each genuine answer
    line.to_host = lambda sent: change(sent) + sent
    for _ in range(30):
        line.pass_ms(1)
        line.driver.exchange(PARAMS.safety.retract_position_m)
        assert line.driver.report.status == "ok"
    assert line.driver.exchanges == taken + 30
    assert line.driver.refused_answers >= 29
    # in its place
    line.to_host = change
    for _ in range(80):
        line.pass_ms(1)
        sample = line.driver.exchange(PARAMS.safety.retract_position_m)
        assert sample.force_n == pytest.approx(genuine.force_n, abs=1e-9)
        if line.driver.report.status == "lost":
            break
    assert line.driver.report.status == "lost"
    assert "answers were refused, the last one of unit" in line.driver.report.text


def test_a_library_that_logs_every_broken_frame_does_not_fill_the_disk(capsys: pytest.CaptureFixture[str]) -> None:
    from telenano.runtime.loop.log import StructuredLog, configure_logging

    configure_logging(as_json=True)
    for number in range(10_000):
        logging.getLogger("pymodbus.logging").error("Unable to decode frame %d", number)
    StructuredLog("afm_node@slave").warning("the instrument is lost")
    written = capsys.readouterr().err.splitlines()
    assert 20 <= len(written) < 100
    assert "the instrument is lost" in written[-1]
