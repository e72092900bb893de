"""What the doctor says about serial ports, on made-up folders of the system."""

import socket
from pathlib import Path

import pytest
import yaml
from telenano_devices.t7.t7_model import calibration_of

from telenano.doctor.devices import check_instrument, check_serial_ports
from telenano.wire.errors import ConfigError


def world(tmp_path: Path, *, latency_ms: int, programs: tuple[str, ...] = ()) -> tuple[Path, Path, Path]:
    devices, usb, processes = (tmp_path / name for name in ("dev", "usb", "proc"))
    (usb / "ttyUSB0").mkdir(parents=True)
    (usb / "ttyUSB0/latency_timer").write_text(f"{latency_ms}\n")
    devices.mkdir()
    for name in ("ttyUSB0", "ttyACM0", "tty1"):
        (devices / name).touch()
    processes.mkdir()
    for number, program in enumerate(("init", *programs)):
        (processes / str(number + 1)).mkdir()
        (processes / str(number + 1) / "comm").write_text(f"{program}\n")
    (processes / "self").mkdir()
    return devices, usb, processes


def test_no_port_is_no_finding(tmp_path: Path) -> None:
    assert check_serial_ports(tmp_path, tmp_path, tmp_path) == []


def test_good_adapter_is_ok(tmp_path: Path) -> None:
    findings = check_serial_ports(*world(tmp_path, latency_ms=1))
    assert [(finding.name, finding.level) for finding in findings] == [("serial ports", "ok"), ("latency timer", "ok")]
    assert "ttyACM0" in findings[0].found
    assert "tty1" not in findings[0].found


def test_what_delays_and_disturbs_is_named_with_its_number(tmp_path: Path) -> None:
    findings = check_serial_ports(*world(tmp_path, latency_ms=16, programs=("ModemManager", "brltty")))
    warned = {finding.name: finding for finding in findings if finding.level == "warning"}
    assert set(warned) == {"latency timer", "ModemManager", "brltty"}
    assert "16 ms" in warned["latency timer"].found
    assert "echo 1" in warned["latency timer"].advice
    assert "AT commands" in warned["ModemManager"].found


def test_port_that_is_open_elsewhere_is_named_with_its_process(tmp_path: Path) -> None:
    devices, usb, processes = world(tmp_path, latency_ms=1, programs=("minicom",))
    (processes / "2/fd").mkdir()
    (processes / "2/fd/7").symlink_to(devices / "ttyACM0")
    findings = {finding.name: finding for finding in check_serial_ports(devices, usb, processes)}
    assert findings["port in use"].level == "warning"
    assert "ttyACM0 is open in minicom (2)" in findings["port in use"].found


def stage_file(folder: Path, host: str, port: int) -> Path:
    path = folder / "stage.yaml"
    path.write_text(yaml.safe_dump(calibration_of(6.25e6, 40.0, host, port)))
    return path


def test_instrument_that_is_reached_and_one_that_is_not(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert check_instrument(stage_file(tmp_path, "127.0.0.1", port)).level == "ok"
    refused = check_instrument(stage_file(tmp_path, "127.0.0.1", port))
    assert (refused.level, refused.found) == (
        "problem",
        f"127.0.0.1:{port}: there is a machine, and it refuses the port",
    )
    assert "a T7 listens on 502" in refused.advice
    unknown = check_instrument(stage_file(tmp_path, "no-such-machine.invalid", 502))
    assert "the name is not known" in unknown.found
    with pytest.raises(ConfigError, match="missing"):
        check_instrument(tmp_path / "missing.yaml")


def test_instrument_that_swallows_everything_is_given_up(tmp_path: Path) -> None:
    # nobody accepts, and the queue of one is full: what a firewall does that drops
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        port = server.getsockname()[1]
        waiting = [socket.socket() for _ in range(4)]
        for client in waiting:
            client.setblocking(False)
            client.connect_ex(("127.0.0.1", port))
        found = check_instrument(stage_file(tmp_path, "127.0.0.1", port), 0.2)
        for client in waiting:
            client.close()
    assert found.level == "problem"
    assert "no answer within 0.2 s" in found.found
    assert "firewall" in found.advice
