import math

import numpy as np
import pytest

from telenano.link.models.loss import GilbertElliottChain, MarkovLossChain
from telenano.link.random_streams import stream
from telenano.settings.link_settings import GilbertElliott, MarkovLoss

MANY = 300_000


def stationary(transition):
    """Stationary distribution of a chain, by linear algebra."""
    size = len(transition)
    system = np.vstack([transition.T - np.eye(size), np.ones(size)])
    return np.linalg.lstsq(system, np.append(np.zeros(size), 1.0), rcond=None)[0]


def mean_run(transition, share, inside):
    """Mean length of the visits to a set of states: share of the set over the rate of entering it."""
    inside = np.asarray(inside)
    entering = share[~inside] @ transition[np.ix_(~inside, inside)].sum(axis=1)
    return share[inside].sum() / entering


def batches(lost):
    """Mean and its standard error by batch means, which holds for correlated samples."""
    means = np.asarray(lost[: len(lost) // 100 * 100], dtype=float).reshape(100, -1).mean(axis=1)
    return means.mean(), means.std(ddof=1) / 10


def runs(indicator):
    edges = np.flatnonzero(np.diff(np.concatenate(([0], indicator.astype(int), [0]))))
    return edges[1::2] - edges[::2]


MARKOV = [
    MarkovLoss(p13=0.05, p31=0.4, p32=0.2, p23=0.3, p14=0.02),
    MarkovLoss(p13=0.01, p31=0.1),
    MarkovLoss(p14=0.1),
    MarkovLoss(p13=0.02, p31=0.05, p32=0.5, p23=0.9, p14=0.01),
]


@pytest.mark.parametrize("chain", MARKOV)
def test_markov_loss_has_the_rate_and_the_bursts_of_its_chain(chain):
    p13, p31, p32, p23, p14 = chain.p13, chain.p31, chain.p32, chain.p23, chain.p14
    transition = np.array(
        [
            [1 - p13 - p14, 0, p13, p14],
            [0, 1 - p23, p23, 0],
            [p31, p32, 1 - p31 - p32, 0],
            [1, 0, 0, 0],
        ]
    )
    share = stationary(transition)
    loses = MarkovLossChain(chain, stream(11, "markov"))
    lost = np.array([loses() for _ in range(MANY)])
    rate, error = batches(lost)
    assert abs(rate - share[2:].sum()) < 4 * error
    assert error < 0.1 * rate
    expected = mean_run(transition, share, [False, False, True, True])
    lengths = runs(lost)
    assert abs(lengths.mean() - expected) < 4 * lengths.std() / math.sqrt(len(lengths)) + 1e-12
    # The closed form that the documentation prints.
    closed = (p14 + p13 / p31) / (1 + p14 + p13 / p31 * (1 + p32 / p23))
    assert math.isclose(closed, share[2:].sum(), rel_tol=1e-9)


ELLIOTT = [
    GilbertElliott(p=0.01, r=0.2),
    GilbertElliott(p=0.05, r=0.5, loss_in_bad=0.6, loss_in_good=0.01),
    GilbertElliott(p=0.002, r=0.05, loss_in_bad=0.9),
    GilbertElliott(p=0.0, r=1.0, loss_in_good=0.3),
]


@pytest.mark.parametrize("chain", ELLIOTT)
def test_gilbert_elliott_has_the_loss_rate_and_the_lag_one_memory_of_its_chain(chain):
    transition = np.array([[1 - chain.p, chain.p], [chain.r, 1 - chain.r]])
    share = stationary(transition)
    loss = np.array([chain.loss_in_good, chain.loss_in_bad])
    loses = GilbertElliottChain(chain, stream(12, "step"), stream(12, "decide"))
    lost = np.array([loses() for _ in range(MANY)])
    rate, error = batches(lost)
    assert abs(rate - share @ loss) < 4 * error
    closed = (chain.loss_in_good * chain.r + chain.loss_in_bad * chain.p) / (chain.p + chain.r)
    assert math.isclose(closed, share @ loss, rel_tol=1e-9)
    both, error = batches(lost[1:] & lost[:-1])
    assert abs(both - (share * loss) @ transition @ loss) < 4 * error


@pytest.mark.parametrize(("p", "r"), [(0.01, 0.2), (0.1, 0.5), (0.005, 0.04)])
def test_gilbert_bursts_and_gaps_are_geometric(p, r):
    loses = GilbertElliottChain(GilbertElliott(p=p, r=r), stream(13, "step"), stream(13, "decide"))
    lost = np.array([loses() for _ in range(MANY)])
    bursts, gaps = runs(lost), runs(~lost)
    for lengths, q in ((bursts, r), (gaps, p)):
        assert abs(lengths.mean() * q - 1) < 4 / math.sqrt(len(lengths))
        # Geometric: P(length > n) = (1 - q)^n.
        n = round(1 / q)
        survival = (1 - q) ** n
        sigma = math.sqrt(survival * (1 - survival) / len(lengths))
        assert abs((lengths > n).mean() - survival) < 4 * sigma


def test_chains_start_good():
    loses = GilbertElliottChain(GilbertElliott(p=1.0, r=1.0), stream(1, "a"), stream(1, "b"))
    assert [loses() for _ in range(4)] == [False, True, False, True]
    loses = MarkovLossChain(MarkovLoss(p13=1.0, p31=1.0), stream(1, "a"))
    assert [loses() for _ in range(4)] == [True, False, True, False]
