import pytest

from telenano.recording.channel_filter import Selection, matcher, node_matcher
from telenano.recording.messages import RecordedChannel
from telenano.wire.errors import ConfigError


def channel(name: str, src: str = "afm_node@slave") -> RecordedChannel:
    return RecordedChannel(name, name.partition("@")[0], "slave", "direct", src, 1000.0, "latest")


@pytest.mark.parametrize(
    ("pattern", "name", "matches"),
    [
        ("afm/state", "afm/state", True),
        ("afm/state", "afm/state@master", False),
        ("afm/*", "afm/command", True),
        ("*@slave", "teleop/forward@slave", True),
        ("/state$/", "haptic/state", True),
        ("/^afm/", "haptic/afm", False),
        ("[ah]*/state", "haptic/state", True),
    ],
)
def test_globs_and_regular_expressions(pattern: str, name: str, matches: bool) -> None:
    assert matcher(pattern)(name) is matches


def test_a_node_is_meant_by_name_or_key() -> None:
    assert node_matcher("controller")("controller@slave")
    assert node_matcher("controller@master")("controller@master")
    assert not node_matcher("controller@master")("controller@slave")


def test_exclusion_wins_and_nothing_given_is_everything() -> None:
    assert Selection.of()(channel("afm/state"))
    chosen = Selection.of(["afm/*"], ["*/command"])
    assert [chosen(channel(name)) for name in ("afm/state", "afm/command", "haptic/state")] == [True, False, False]
    assert not Selection.of(nodes=["haptic_node"])(channel("afm/state"))


def test_a_wrong_expression_is_named() -> None:
    with pytest.raises(ConfigError, match=r"/\(/: is not a regular expression"):
        Selection.of(["/(/"])
