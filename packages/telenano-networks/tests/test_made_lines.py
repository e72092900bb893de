"""A model is said to agree with lines that it can be like, and with none that it cannot."""

import pytest
from made_lines import KINDS, made
from telenano_networks.line_fit import accept
from telenano_networks.line_log import LineLog, Segment


@pytest.mark.check("fits a line of each kind, twice")
@pytest.mark.parametrize("kind", KINDS)
def test_a_line_agrees_where_a_model_of_the_link_can_be_like_it(kind) -> None:  # type: ignore[no-untyped-def]
    agrees = [
        all(row.agrees for row in accept(LineLog((Segment(*made(kind, seed)),), round_trip=True))) for seed in range(2)
    ]
    # by chance one of the statistics of a right model is outside of its interval now and then
    assert any(agrees) if KINDS[kind] else not any(agrees)
