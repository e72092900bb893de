"""How tests run the closed loop of `telenano.lockstep`: compiled where a law would be noticed, else as plain Python."""

import pytest


@pytest.fixture
def loop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile the closed loop for each law over the sample and for one law on a spring; the other laws run plain there.

    So a law or an environment that cannot be compiled is noticed, and no pair of them costs a compilation of its own.
    """
    monkeypatch.setattr("telenano.lockstep.lockstep.PLAIN_TICKS", 0)
    given = request.node.callspec.params
    if given.get("environment", "spring") == "spring" and given["law"] != "virtual_impedance":
        request.getfixturevalue("plain_loop")
