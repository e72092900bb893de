"""The force clamp of the slave: off and on for every law, and what it refuses."""

from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.cells import Cell, trajectory_of
from tried_laws import TRIED_LAWS

from telenano.extend.laws import NO_SIGNAL, SlaveReference, TipMeasurement
from telenano.laws.clamp import NO_LIMIT_N, ClampParams, clamped
from telenano.lockstep import lockstep
from telenano.sections.clamp_section import ClampConfig
from telenano.sections.controller_section import LAWS, ControllerConfig

PARAMS = ClampParams(True, 1e8, 1.5e-6 * 1e-3 / 30.0, 0.1)


def tip(force_n: float, *, following: bool = True) -> TipMeasurement:
    return TipMeasurement(1e-8, force_n, 0.0, False, force_n != 0.0, following, 0.0)


def pressing(force_n: float, *, active: bool = True) -> Any:
    return NO_SIGNAL._replace(active=active, force_n=force_n, silence_s=0.0)


def test_towards_the_sample_it_lets_through_what_the_hand_presses_more() -> None:
    wanted = SlaveReference(9e-8, True)
    # 1 N at the hand and a margin of 0.1 N, against 0.8 N at the tip
    let_through = clamped(PARAMS, wanted, pressing(1e-8), tip(0.8e-8))
    assert let_through.position_m == pytest.approx(1e-8 + PARAMS.reach_m_per_n * 0.3, rel=1e-12, abs=0.0)
    # 2 N at the tip: it gives way, whatever the reference
    assert clamped(PARAMS, wanted, pressing(1e-8), tip(2e-8)).position_m < 1e-8


def test_away_from_the_sample_nothing_is_limited() -> None:
    assert clamped(PARAMS, SlaveReference(-5e-8, True), pressing(1e-8), tip(0.0)) == SlaveReference(-5e-8, True)


def test_without_hand_or_tip_it_does_not_act() -> None:
    wanted = SlaveReference(9e-8, True)
    assert clamped(PARAMS, wanted, pressing(1e-8, active=False), tip(2e-8)) == wanted
    assert clamped(PARAMS, wanted, pressing(1e-8), tip(2e-8, following=False)) == wanted
    assert clamped(PARAMS._replace(enabled=False), wanted, pressing(1e-8), tip(2e-8)) == wanted


@pytest.mark.parametrize("law", TRIED_LAWS)
@pytest.mark.parametrize("enabled", [None, False, True])
def test_every_law_has_one_clamp_at_most(law: str, enabled: bool | None) -> None:
    config = ControllerConfig.model_validate({"law": law, "clamp": {"enabled": enabled}})
    behind, params = config.clamp_params(), config.params()
    own = hasattr(params, "margin_n") and getattr(params, "clamped", True) and params.margin_n < NO_LIMIT_N
    by_default = law in ("passivity", "model_mediated")
    assert behind.enabled + own == (by_default if enabled is None else enabled)
    assert config.local_loop == (LAWS[law].local_loop or bool(enabled))


@pytest.mark.check("takes 1.7 s")
def test_clamp_alone_holds_position_force_at_any_delay(run_loop: Any) -> None:
    clamp = ClampConfig(enabled=True, force_margin_n=0.0)
    held = {}
    for enabled in (False, True):
        run = run_loop(
            "position_force",
            lambda n: min(1.0, n / 400),
            lambda x: 20.0 * x,
            4000,
            lambda n: 100,
            lambda n: 100,
            clamp=clamp.model_copy(update={"enabled": enabled}),
        )
        held[enabled] = 1e8 * run.force_n[-500:]
    assert held[True] == pytest.approx(1.0, rel=0.01, abs=0.0)
    assert held[False].max() > 10.0


@pytest.mark.check("takes 1.1 s")
@pytest.mark.parametrize(("hand", "swing_n"), [("force", 0.6), ("ordinary", 0.4)])
def test_a_clamp_bounds_the_force_and_does_not_end_the_swing_of_the_law(
    monkeypatch: pytest.MonkeyPatch, hand: Any, swing_n: float
) -> None:
    monkeypatch.setattr(lockstep, "compiled_call", lambda step, given: step(*given))
    cell = Cell(
        law="position_force",
        environment="spring",
        hand=hand,
        round_trip_ms=200.0,
        stiffness_n_per_m=20.0,
        settings=(("clamp.enabled", True),),
        session_s=5.0,
    )
    force = 1e8 * trajectory_of(cell).tip_force_n[-2500:]
    assert force.max() < 1.11
    assert np.ptp(force) == pytest.approx(swing_n, rel=0.2, abs=0.0)


def test_two_laws_come_with_the_clamp() -> None:
    """A clamp of the law's own counts as on while its margin is one that a hand can meet."""
    margins = {law: getattr(ControllerConfig(law=law).params(), "margin_n", NO_LIMIT_N) for law in TRIED_LAWS}
    assert {name for name, margin in margins.items() if margin < NO_LIMIT_N} - {"wave"} == {
        "passivity",
        "model_mediated",
    }
    assert not ControllerConfig(law="wave").params().clamped
