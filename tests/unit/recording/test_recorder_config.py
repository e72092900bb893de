from typing import Any

import pytest

from telenano.recording.recorder_config import RecorderConfig
from telenano.settings.config import validate
from telenano.wire.errors import ConfigError
from telenano.wire.topics import OWN_TOPICS


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


def test_only_what_is_recorded_commands_or_triggers_is_subscribed_to() -> None:
    lean = RecorderConfig(exclude=("afm/*", "teleop/forward@slave", "session/*"))
    subscribed = {(topic, site): lean.subscribes(topic, site) for topic in OWN_TOPICS for site in ("master", "slave")}
    assert {place for place, wanted in subscribed.items() if not wanted} == {
        (topic, site)
        for topic in ("afm/command", "afm/state", "afm/scanline", "afm/program")
        for site in ("master", "slave")
    }
    # what was sent at this site, or out of the link: one of both is recorded
    assert subscribed["teleop/forward", "slave"]
    assert not RecorderConfig(topics=("haptic/*",)).subscribes("teleop/forward", "slave")
    assert RecorderConfig(topics=("teleop/forward@slave",)).subscribes("teleop/forward", "slave")
    assert not RecorderConfig(topics=("teleop/forward@slave",)).subscribes("teleop/forward", "master")
