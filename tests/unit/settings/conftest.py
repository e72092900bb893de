"""No test of settings sees what the environment overrides."""

import os

import pytest


@pytest.fixture(autouse=True)
def _no_overrides_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("TELENANO__")]:
        monkeypatch.delenv(name)
