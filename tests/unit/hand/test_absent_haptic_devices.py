"""A driver of a package that is not installed is named with the command that installs it."""

import re
from typing import Any

import pytest

from telenano.sections import HapticConfig
from telenano.sections.hand_section import DRIVERS
from telenano.settings import entries, validate
from telenano.wire import ConfigError
from telenano.wire.extras import how_to_add_package


def test_without_its_package_a_driver_gets_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing: entries.LoadedEntries[Any] = entries.LoadedEntries({}, {})
    monkeypatch.setattr(entries, "load", lambda *given: nothing)
    # what was found before
    monkeypatch.setattr(DRIVERS, "_asked", {})
    how = re.escape(how_to_add_package("telenano-devices"))
    named = {name: ("driver", f"driver {name}", name) for name in ("haply", "dhd", "hd", "simulated_impedance")}
    named |= {name: (name, f"section {name}", {}) for name in ("coupling", "impedance")}
    for key, words, value in named.values():
        with pytest.raises(ConfigError, match=f"{key}: the {words} is in the package telenano-devices: {how}"):
            validate(HapticConfig, {key: value}, "file", "haptic_node")
