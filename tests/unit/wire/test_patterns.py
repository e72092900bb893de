"""Patterns of a person are bounded where they are read: none of them keeps its reader."""

import time
from fnmatch import fnmatchcase

import pytest

from telenano.recording.channel_filter import Selection
from telenano.recording.field_differences import Tolerances
from telenano.settings.link_settings import DirectionSettings
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import is_meant
from telenano.wire.patterns import MOST_LETTERS, fault_of_pattern, matches

LONG = [letters * 40_000 for letters in ("*[", "[", "*a", "?", "[!")]
# far beyond what it takes [s]
PATIENCE_S = 5.0


@pytest.mark.parametrize("text", LONG)
def test_a_long_pattern_is_refused_where_it_is_read(text: str) -> None:
    begun_s = time.monotonic()
    for key in ("topics", "exclude", "nodes"):
        with pytest.raises(ConfigError, match="letters, and at most 128 are read"):
            Selection.of(**{key: [text]})
    for given in ({"reliable": [text]}, {"reliable": text}, {"topics": {text: {"delay_s": 0.1}}}):
        with pytest.raises(ValueError, match="letters, and at most 128 are read"):
            DirectionSettings.model_validate(given)
    with pytest.raises(ConfigError, match="letters, and at most 128 are read"):
        Tolerances.parse([f"{text}=1"])
    assert not is_meant("afm_node@slave", text) and not matches("afm/state", text)
    assert time.monotonic() - begun_s < PATIENCE_S


def test_what_is_short_enough_means_what_it_meant() -> None:
    for pattern in ("*", "afm/*", "afm/stat?", "[ab]fm/state", "afm/state", "", "*[" * (MOST_LETTERS // 2)):
        assert fault_of_pattern(pattern) == ""
        assert matches("afm/state", pattern) == fnmatchcase("afm/state", pattern)
