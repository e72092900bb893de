"""A model is said to agree with lines that it can be like, and with none that it cannot."""

import pytest
from made_lines import KINDS, made
from telenano_lab.networks.line_fit import accept
from telenano_lab.networks.line_log import LineLog, Segment

SEEDS = 3
MOST_REFUSED = 0.3


@pytest.mark.endurance("fits 36 lines of twelve kinds")
def test_a_line_agrees_where_a_model_of_the_link_can_be_like_it() -> None:
    agrees = {
        kind: [
            all(row.agrees for row in accept(LineLog((Segment(*made(kind, seed)),), round_trip=True)))
            for seed in range(SEEDS)
        ]
        for kind in KINDS
    }
    for kind, can in KINDS.items():
        # by chance one of the statistics of a right model is outside of its interval now and then
        assert can is None or (sum(agrees[kind]) >= SEEDS - 1 if can else not any(agrees[kind])), kind
    assert sum(not one for found in agrees.values() for one in found) <= MOST_REFUSED * SEEDS * len(KINDS)
