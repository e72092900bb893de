"""Fixture that runs the closed loop of `telenano.lockstep` compiled or as plain Python, to limit compilations."""

import pytest


@pytest.fixture
def loop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile the closed loop for each law over the sample, and for one law on a spring; others on a spring run plain.

    So a law or an environment that cannot be compiled is noticed, without a compilation for each pair of both.
    """
    monkeypatch.setattr("telenano.lockstep.lockstep.PLAIN_TICKS", 0)
    given = request.node.callspec.params
    if given.get("environment", "spring") == "spring" and given["law"] != "virtual_impedance":
        request.getfixturevalue("plain_loop")
