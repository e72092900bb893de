from typing import Any

import pytest

from services.recorder.config import RecorderConfig
from services.runtime.config import validate
from services.runtime.errors import ConfigError


def test_a_yaml_section_becomes_a_configuration() -> None:
    config = validate(RecorderConfig, {"directory": "out", "flush_interval_s": 0.05}, "rig.yaml", "recorder")
    assert str(config.directory) == "out"
    assert config.flush_interval_s == 0.05


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("flush_interval_s", 0.251),
        ("flush_interval_s", 0.0),
        ("compression", "gzip"),
        ("file_name", "../session.mcap"),
        ("file_name", "session.bag"),
        ("chunk_size_bytes", 0),
        ("sync_to_disk", "yes"),
        ("speed", 1),
    ],
)
def test_what_is_wrong_is_named(key: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=rf"rig\.yaml: recorder\.{key}"):
        validate(RecorderConfig, {key: value}, "rig.yaml", "recorder")
