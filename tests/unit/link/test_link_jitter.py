import math

import numpy as np
import pytest
from scipy import stats

from telenano.link.models.jitter import JitterSource, table_quantile
from telenano.link.random_streams import stream
from telenano.settings.link_settings import Jitter

MANY = 200_000
SCALE_S = 0.004


def sample(settings, samples=(), count=MANY):
    source = JitterSource(settings, samples, stream(21, "jitter"))
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


@pytest.mark.parametrize("correlation", [0.3, 0.9])
def test_correlation_is_that_of_successive_normal_delays(correlation):
    x = sample(Jitter(scale_s=SCALE_S, distribution="normal", correlation=correlation))
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1] - correlation) < 0.02
    assert abs(np.corrcoef(x[:-4], x[4:])[0, 1] - correlation**4) < 0.03


def test_uniform_rank_correlation_follows_from_that_of_the_scores():
    x = sample(Jitter(scale_s=SCALE_S, distribution="uniform", correlation=0.5))
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1] - 6 / math.pi * math.asin(0.25)) < 0.02


def test_table_reproduces_the_quantiles_of_its_samples():
    values = [1.0, 2.0, 3.0, 10.0]
    x = sample(Jitter(scale_s=SCALE_S, distribution="table", table_file="t"), values)
    for q in (0.1, 0.4, 0.8):
        assert abs((x < np.quantile(values, q)).mean() - q) < 4 * math.sqrt(q * (1 - q) / MANY)
    assert x.min() >= 1.0
    assert x.max() <= 10.0


def test_table_of_one_sample_is_a_constant():
    assert table_quantile([2.5])(0.7) == 2.5


PAIRS = ((0.0, 0.010), (0.5, 0.016), (0.9, 0.020), (1.0, 0.080))


def test_pairs_are_the_quantiles_of_the_delay():
    x = sample(Jitter(scale_s=1.0, distribution="table", quantiles=PAIRS), count=MANY)
    for share, value in ((0.25, 0.013), (0.5, 0.016), (0.9, 0.020), (0.95, 0.050)):
        assert abs((x < value).mean() - share) < 4 * math.sqrt(share * (1 - share) / MANY), share


@pytest.mark.parametrize("rate_hz", [50, 1000])
def test_what_lasts_has_its_correlation_time_and_its_distribution_at_any_rate_of_sending(rate_hz):
    time_s, count = 0.05, 100_000
    source = JitterSource(Jitter(scale_s=1.0, correlation_time_s=time_s), (), stream(5, "jitter"))
    x = np.array([source(round(n * 1e9 / rate_hz)) for n in range(count)]) * 1e-9
    independent = count / rate_hz / time_s / 2
    assert abs(x.mean()) < 4 / math.sqrt(independent)
    assert x.std() == pytest.approx(1.0, abs=4 / math.sqrt(independent))
    for lag_s in (0.02, 0.06, 0.2):
        lag = round(lag_s * rate_hz)
        expected = math.exp(-lag / rate_hz / time_s)
        assert np.mean(x[:-lag] * x[lag:]) == pytest.approx(expected, abs=0.02 + 4 / math.sqrt(independent)), lag_s


def test_two_parts_of_the_scores_last_for_times_of_their_own():
    slow, fast = (
        JitterSource(Jitter(scale_s=1.0, correlation_time_s=time_s), (), stream(5, f"jitter of {time_s}"))
        for time_s in (0.5, 0.02)
    )
    source = slow.beside(fast, 0.6)
    x = np.array([source(n * 10_000_000) for n in range(100_000)]) * 1e-9
    assert abs(x.mean()) < 0.1
    assert x.std() == pytest.approx(1.0, abs=0.03)
    for lag in (1, 2, 10, 50):
        expected = 0.4 * math.exp(-lag / 50) + 0.6 * math.exp(-lag / 2)
        assert np.mean(x[:-lag] * x[lag:]) == pytest.approx(expected, abs=0.05), lag


def test_what_lasts_depends_on_the_time_and_not_on_what_was_sent():
    settings = Jitter(scale_s=1.0, correlation_time_s=0.02)
    every, some = (JitterSource(settings, (), stream(5, "jitter"), 7) for _ in range(2))
    of_every = {n: every(7 + n * 1_000_000) for n in range(3000)}
    assert all(some(7 + n * 1_000_000) == of_every[n] for n in range(13, 3000, 41))


def test_a_long_pause_is_jumped_over():
    draws = []
    draw = stream(5, "jitter")
    source = JitterSource(Jitter(scale_s=1.0, correlation_time_s=1e-6), (), lambda: draws.append(0) or draw())
    source(0)
    assert source(3600 * 10**9) != source(3600 * 10**9 + 10**6)
    assert len(draws) < 20_000
