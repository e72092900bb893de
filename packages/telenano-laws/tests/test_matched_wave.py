"""Both ends of the line and its guard have the numbers of the check case."""

import pytest
from telenano_laws.matched_wave import Inbox, MatchedWaveConfig, drawn, guarded_wave, hand_end, tip_end

PERIOD_S, B = 1e-3, 20.0


@pytest.mark.parametrize(
    ("velocity", "wave", "force", "sent"),
    [(0.1, 0.0, 2.0, 0.632455532), (0.1, -0.158113883, 3.0, 0.790569415), (0.0, -0.158113883, 1.0, 0.158113883)],
)
def test_the_end_at_the_hand(velocity: float, wave: float, force: float, sent: float) -> None:
    assert hand_end(B, velocity, wave) == pytest.approx((force, sent), rel=1e-8)


def test_the_matched_end_at_the_tip_sends_nothing_of_the_wave_back() -> None:
    assert tip_end(B, 0.632455532, 1.0) == pytest.approx((0.075, -0.158113883), rel=1e-8)
    assert tip_end(B, 5.0, 1.0)[1] == tip_end(B, 0.0, 1.0)[1]


@pytest.mark.parametrize(
    ("wave", "left_j", "used"),
    [(0.8, 5e-4, 0.8), (0.8, 2e-4, 0.632455532), (0.8, 0.0, 0.0), (-0.8, 2e-4, -0.632455532)],
)
def test_a_wave_is_guarded_by_the_energy_that_has_come(wave: float, left_j: float, used: float) -> None:
    assert guarded_wave(wave, left_j, PERIOD_S) == pytest.approx(used, rel=1e-8, abs=1e-15)


def test_what_a_lost_message_had_is_made_up_for_and_never_without_energy() -> None:
    params = MatchedWaveConfig(impedance_n_s_per_m=B, drift_rate_per_s=10.0).to_params(PERIOD_S)
    # a wave of 0.5 sqrt(W) was sent over 100 periods, and the first fifty messages were lost
    wave, root = 0.5, (0.5 * B) ** 0.5
    inbox, taken_j = Inbox(0.0, 0.0, 0.0, 0.0), 0.0
    for period in range(1, 1001):
        sent = min(period, 100) * wave * PERIOD_S
        if period > 50:
            inbox = inbox._replace(received_m=sent / root, received_j=0.5 * wave * sent)
        now = wave if 50 < period <= 100 else 0.0
        inbox, used = drawn(params, inbox, now)
        taken_j += 0.5 * used * used * PERIOD_S
        assert taken_j <= inbox.received_j + 1e-15
    missing = root * (inbox.received_m - inbox.taken_m)
    assert 0.0 <= missing < 1e-3 * 100 * wave * PERIOD_S
