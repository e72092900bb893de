"""The codes of both guards: numbers that stand in the journals of recordings, and bits that can be told apart."""

from telenano.afm import safety as tip
from telenano.extend.hands import MODE_NAMES
from telenano.hand import safety as hand


def test_codes_of_the_guards_keep_their_numbers_which_journals_of_recordings_hold() -> None:
    assert list(tip.MODE_NAMES) == list(range(5))
    assert list(tip.ACTION_NAMES) == list(range(3))
    assert list(tip.REASON_NAMES) == list(range(12))
    assert list(tip.ARM_REFUSAL_NAMES) == list(range(5))
    assert list(MODE_NAMES) == list(range(3))
    assert list(hand.REASONS) == list(range(11))


def test_limits_by_range_and_by_speed_are_bits_of_their_own() -> None:
    assert (tip.LIMITED_BY_RANGE, tip.LIMITED_BY_SPEED) == (1, 2)
