"""What the doctor says about the instrument of a calibration file."""

import socket
from pathlib import Path

import pytest
import yaml
from telenano_emulators.t7_model import calibration_of

from telenano.doctor.devices import check_instrument
from telenano.wire.errors import ConfigError


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
