"""The law keeps the rules of the rig, and holds the paper's contact."""

import telenano


def test_the_law_keeps_every_rule() -> None:
    assert {rule: faults for rule, faults in telenano.check_law("law_of_a_release").items() if faults} == {}


def test_a_hand_of_one_newton_presses_with_one_newton() -> None:
    session = telenano.simulate(law="law_of_a_release", round_trip_ms=0.0)
    assert session.verdict == "stable"
    hold = (session["time_s"] > 2.2) & (session["time_s"] < 2.5)
    assert abs(session["scaled_tip_force_n"][hold].mean() - 1.0) < 0.02
