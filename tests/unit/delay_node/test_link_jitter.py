import math

import numpy as np
import pytest
from scipy import stats

from services.delay_node.config import Jitter
from services.delay_node.models.jitter import JitterSource, table_quantile
from services.delay_node.random_streams import stream

MANY = 200_000
SCALE_S = 0.004


def sample(settings, samples=(), count=MANY):
    source = JitterSource(settings, samples, lambda name: stream(21, name))
    return np.array([source() for _ in range(count)]) / 1e9 / settings.scale_s


def standard_pareto(shape):
    raw = stats.pareto(shape)
    return stats.pareto(shape, loc=-raw.mean() / raw.std(), scale=1 / raw.std())


LAWS = {
    "uniform": stats.uniform(-1, 2),
    "normal": stats.norm(),
    "pareto": standard_pareto(3.0),
}


@pytest.mark.parametrize("correlation", [0.0, 0.6])
@pytest.mark.parametrize("distribution", LAWS)
def test_quantiles_are_those_of_the_law_with_and_without_correlation(distribution, correlation):
    x = sample(Jitter(scale_s=SCALE_S, distribution=distribution, correlation=correlation))
    law = LAWS[distribution]
    for q in (0.001, 0.05, 0.25, 0.5, 0.75, 0.95, 0.999):
        # The share below the theoretical quantile is q; its error grows with the memory of the sequence.
        sigma = math.sqrt(q * (1 - q) / MANY * (1 + correlation) / (1 - correlation))
        assert abs((x < law.ppf(q)).mean() - q) < 4 * sigma, q


def test_pareto_jitter_is_bounded_below_and_has_a_heavy_tail():
    x = sample(Jitter(scale_s=SCALE_S, distribution="pareto", pareto_shape=4.0))
    law = standard_pareto(4.0)
    assert x.min() >= law.support()[0] - 1e-9
    assert abs((x > 5).mean() - law.sf(5)) < 4 * math.sqrt(law.sf(5) / MANY)
    assert law.sf(5) > 1000 * stats.norm.sf(5)


def test_pareto_normal_is_the_normalised_sum_of_both():
    x = sample(Jitter(scale_s=SCALE_S, distribution="pareto_normal"))
    weights = np.array([0.25, 0.75]) / math.hypot(0.25, 0.75)
    pareto = standard_pareto(3.0)
    # P(w_n N + w_p P < t) = E[Phi((t - w_p P)/w_n)], by midpoints of the Pareto quantiles.
    points = pareto.ppf((np.arange(200_000) + 0.5) / 200_000)
    for t in (-1.0, -0.5, 0.0, 0.5, 2.0):
        expected = stats.norm.cdf((t - weights[1] * points) / weights[0]).mean()
        assert abs((x < t).mean() - expected) < 4 * math.sqrt(expected * (1 - expected) / MANY)


@pytest.mark.parametrize("correlation", [0.3, 0.9])
def test_correlation_is_that_of_successive_normal_delays(correlation):
    x = sample(Jitter(scale_s=SCALE_S, distribution="normal", correlation=correlation))
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1] - correlation) < 0.02
    assert abs(np.corrcoef(x[:-4], x[4:])[0, 1] - correlation**4) < 0.03


def test_uniform_rank_correlation_follows_from_that_of_the_scores():
    x = sample(Jitter(scale_s=SCALE_S, distribution="uniform", correlation=0.5))
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1] - 6 / math.pi * math.asin(0.25)) < 0.02


def test_table_reproduces_the_quantiles_of_its_samples():
    values = [3.0, 1.0, 2.0, 10.0]
    x = sample(Jitter(scale_s=SCALE_S, distribution="table", table_file="t"), values)
    for q in (0.1, 0.4, 0.8):
        assert abs((x < np.quantile(values, q)).mean() - q) < 4 * math.sqrt(q * (1 - q) / MANY)
    assert x.min() >= 1.0
    assert x.max() <= 10.0


def test_table_of_one_sample_is_a_constant():
    assert table_quantile([2.5])(0.7) == 2.5
