"""How tests run the closed loop of `telenano.lockstep`: as plain Python, or compiled where a law would be noticed."""

import pytest


@pytest.fixture
def plain_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the closed loop as plain Python: the same bits, and one session takes less time than compiling the loop."""
    monkeypatch.setattr("telenano.lockstep.lockstep.compiled_call", lambda step, given: step(*given))
    monkeypatch.setattr("telenano.lockstep.lockstep.is_compiled", lambda step, given: False)


@pytest.fixture
def loop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile the closed loop for each law over the sample and for one law on a spring; the other laws run plain there.

    So a law or an environment that cannot be compiled is noticed, and no pair of them costs a compilation of its own.
    """
    monkeypatch.setattr("telenano.lockstep.lockstep.PLAIN_TICKS", 0)
    given = request.node.callspec.params
    if given.get("environment", "spring") == "spring" and given["law"] != "virtual_impedance":
        request.getfixturevalue("plain_loop")
