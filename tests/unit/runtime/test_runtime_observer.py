import json

import numpy as np
import pytest

from telenano.recording.json_values import json_fields
from telenano.runtime.wiring.observer import Observer, known_name
from telenano.wire.errors import ConfigError
from telenano.wire.messages import AfmScanline, Array


@pytest.mark.parametrize(
    ("node", "src", "name"),
    [
        ("controller@master", "controller@master", "teleop/forward"),
        ("delay_node@slave", "controller@master", "teleop/forward@slave"),
        ("delay_node@master", "controller@slave", "teleop/forward@master"),
    ],
)
def test_a_copy_out_of_the_link_has_a_name_of_its_own(node: str, src: str, name: str) -> None:
    assert Observer.name(node, "teleop/forward", src) == name


def test_names_are_checked() -> None:
    assert known_name("afm/state") == ("afm/state", None)
    assert known_name("teleop/forward@slave") == ("teleop/forward", "slave")
    with pytest.raises(ConfigError, match=r"'afm/stat'.*afm/state"):
        known_name("afm/stat")
    with pytest.raises(ConfigError, match="does not cross the link"):
        known_name("afm/state@master")


def test_a_message_with_an_array_becomes_json() -> None:
    line = AfmScanline(
        seq=0, t_ns=1, src="afm_node@slave", v=1, line=0, lines=1, direction="trace", start_m=(0.0, 0.0, 0.0),
        end_m=(1e-6, 0.0, 0.0), height_m=Array.from_numpy(np.array([1e-9, 2e-9])), amplitude_m=None, phase_rad=None,
    )  # fmt: skip
    fields = json.loads(json.dumps(json_fields(line)))
    assert fields["height_m"] == [1e-9, 2e-9]
    assert fields["end_m"] == [1e-6, 0.0, 0.0]
    assert fields["amplitude_m"] is None
