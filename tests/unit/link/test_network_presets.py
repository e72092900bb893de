"""Every network that comes with the project has the statistics that its file states, by the link's own engine."""

import math
import os
import subprocess
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from telenano.link.direction import DirectionEngine
from telenano.link.models.jitter import JitterSource, hyperexponential_quantile
from telenano.link.random_streams import stream
from telenano.settings.config import validate
from telenano.settings.included import NETWORK_DIRECTORY
from telenano.settings.link_settings import Jitter, LinkSettings
from telenano.settings.network_profiles import PROFILES, Profile, profile_named
from telenano.wire.errors import ConfigError

DIRECTIONS = ("forward", "backward")
MEASURED = tuple((name, way) for name in PROFILES for way in DIRECTIONS)
SIZE_BYTES = 300
# messages in which one that overtakes is met on every line that has some
SURELY_MET = 50_000
# an outage, and a level of the delay, lasts seconds: fewer messages, over a longer time
SPARSE = tuple(
    name for name in PROFILES if {"outage", "second_correlation_time_s"} & set(str(PROFILES[name].link).split("'"))
)


def fates(name, way, count, seed):
    settings = LinkSettings.of({"profile": name, "seed": seed})
    period_ns = 50_000_000 if name in SPARSE else 1_000_000
    return DirectionEngine.fates(settings, way, "teleop/forward", range(0, count * period_ns, period_ns), SIZE_BYTES)


def deviation_by_stalls_ms(name, way, seconds):
    """Return the deviation of a mean delay that the number of log-normal stalls, and their lengths, may make."""
    outage = getattr(LinkSettings.of({"profile": name}), way).outage
    if outage.mode == "drop" or outage.mean_up_s is None:
        return 0.0
    # A stall of the length L adds L^2 / 2 to the integral of the delay.
    fourth = outage.mean_down_s**4 * math.exp(6.0 * outage.down_spread**2)
    return 1e3 * math.sqrt(seconds / outage.mean_up_s * fourth / 4.0) / seconds


def deviation_by_levels(name, way, seconds):
    """Return the deviation of a mean, in deviations of the delay, that comes of how long a level of it lasts."""
    jitter = getattr(LinkSettings.of({"profile": name}), way).jitter
    return math.sqrt(min(1.0, 2.0 * jitter.correlation_time_s * (1.0 - jitter.second_correlation_share) / seconds))


def check(name, way, count, seeds, widest):
    """Hold a direction to its file; `widest` is the error of a mean, in deviations, that chance may make."""
    widest = max(
        widest, min(1.0, 2.0 * deviation_by_levels(name, way, count * seeds * 0.05)) if name in SPARSE else 0.0
    )
    stated = PROFILES[name].statistics[way]
    runs = [fates(name, way, count, seed) for seed in range(seeds)]
    delays = 1e-6 * np.array([fate.delay_ns for run in runs for fate in run if not fate.dropped])
    lost = np.array([bool(fate.dropped) for run in runs for fate in run])
    if stated.mean_ms is not None:
        percentiles = stated.percentiles_ms.values()
        spread = max(percentiles, default=0.0) - min(percentiles, default=0.0)
        room = widest * (spread if stated.deviation_ms is None else stated.deviation_ms) + 0.02 * stated.mean_ms
        room += 4.0 * deviation_by_stalls_ms(name, way, count * seeds * 0.05)
        assert abs(delays.mean() - stated.mean_ms) <= room + 1e-9, f"mean {delays.mean()}"
    if stated.deviation_ms is not None:
        assert delays.std() == pytest.approx(stated.deviation_ms, rel=max(0.1, 3.0 * widest), abs=1e-9)
    for percent, delay_ms in stated.percentiles_ms.items():
        # Where many delays are equal, a percentile is all of their shares.
        below, upto = float((delays < delay_ms - 0.01).mean()), float((delays < delay_ms + 0.01).mean())
        outside = max(below - 0.01 * percent, 0.01 * percent - upto)
        assert outside <= widest, f"{100 * below} to {100 * upto} % are below the percentile {percent}"
    room = 4.0 * math.sqrt(max(stated.lost, 1e-4) / lost.size) * (stated.lost_in_a_row or 1.0) ** 0.5
    assert abs(lost.mean() - stated.lost) <= room * (8.0 if name in SPARSE else 1.5), f"{lost.mean()} lost"
    if stated.lost_in_a_row is not None and lost.sum() > 200:
        rows = [len(list(group)) for is_lost, group in groupby(lost.tolist()) if is_lost]
        assert np.mean(rows) == pytest.approx(stated.lost_in_a_row, rel=4.0 / math.sqrt(len(rows)) + 0.03)
    overtaking = any(fate.reordered for run in runs for fate in run)
    # What is seldom need not be met in few messages.
    assert overtaking == stated.overtakes or (stated.overtakes and delays.size < SURELY_MET)


@pytest.mark.parametrize("name", PROFILES)
def test_a_network_says_where_it_is_from_and_its_file_is_checked(name):
    profile = PROFILES[name]
    assert profile.source or profile.assumed or name == "clean"
    assert set(profile.statistics) == set(DIRECTIONS)
    link = LinkSettings.of({"profile": name})
    assert link.forward.delay_s <= 1e-3 * (profile.statistics["forward"].mean_ms or 0.0) + 1e-9
    assert f"{NETWORK_DIRECTORY / name}.yaml" in profile_error(profile, name)


def profile_error(profile, name):
    path = NETWORK_DIRECTORY / f"{name}.yaml"
    with pytest.raises(ConfigError) as raised:
        validate(Profile, {**profile.model_dump(mode="json"), "sauce": []}, str(path))
    return str(raised.value)


@pytest.mark.parametrize(("name", "way"), [m for m in MEASURED if m[1] == "forward" and m[0] not in SPARSE])
def test_a_network_has_about_the_statistics_of_its_file(name, way):
    check(name, way, 3000, 1, widest=0.6 if PROFILES[name].link and "order" in PROFILES[name].link["forward"] else 0.1)


@pytest.mark.endurance
@pytest.mark.parametrize(("name", "way"), MEASURED)
def test_a_network_has_the_statistics_of_its_file_over_seeds(name, way):
    # what wanders within a second takes longer to show its spread
    slow = name == "leo_satellite"
    check(name, way, 100_000 if slow else 20_000, 3, widest=0.2 if slow else 0.12)


def test_a_profile_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(ConfigError, match=r"unknown profile '6g'; known are clean, 4g, 5g"):
        profile_named("6g")
    assert profile_named("LTE") is PROFILES["lte"]


@pytest.mark.parametrize(("share", "mean"), [(0.0, 1.0), (0.2, 14.9), (0.1, 0.66), (1.0, 3.0)])
def test_the_quantile_of_a_hyperexponential_inverts_its_distribution(share, mean):
    quantile = hyperexponential_quantile(share, mean)
    for u in (2.0**-54, 1e-6, 0.01, 0.5, 0.9, 0.999, 1.0 - 2.0**-53):
        x = quantile(u)
        survives = (1.0 - share) * math.exp(-x) + share * math.exp(-x / mean)
        assert survives == pytest.approx(1.0 - u, rel=1e-10, abs=0.0)


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_hyperexponential_jitter_has_the_mean_and_the_deviation_of_its_parts(correlation):
    jitter = Jitter(
        scale_s=0.010, distribution="hyperexponential", second_share=0.2, second_scale_s=0.15, correlation=correlation
    )
    source = JitterSource(jitter, (), stream(3, "jitter"))
    found_s = 1e-9 * np.array([source() for _ in range(20_000)])
    mean_s = 0.8 * 0.010 + 0.2 * 0.15
    deviation_s = math.sqrt(2.0 * (0.8 * 0.010**2 + 0.2 * 0.15**2) - mean_s**2)
    assert found_s.min() >= 0.0
    assert found_s.mean() == pytest.approx(mean_s, rel=0.05)
    assert found_s.std() == pytest.approx(deviation_s, rel=0.06)


def drawn_by_itself(way):
    """Return whether each message has a delay or a loss by chance that says nothing of the next one's."""
    jitter, loss = way.jitter, way.loss
    wanders = jitter.correlation > 0.0 or jitter.correlation_time_s > 0.0 or way.order != "any"
    return (jitter.scale_s > 0.0 or loss.probability > 0.0 == loss.correlation) and not wanders


@pytest.mark.parametrize("name", PROFILES)
def test_a_network_whose_messages_are_drawn_one_by_one_says_so_in_its_sentence(name):
    way = LinkSettings.of({"profile": name}).forward
    says = "drawn by itself" in PROFILES[name].about or "no memory known" in PROFILES[name].about
    assert says or not drawn_by_itself(way)


def test_a_folder_of_the_environment_has_networks_too(tmp_path: Path) -> None:
    own = (NETWORK_DIRECTORY / "lte.yaml").read_text(encoding="utf-8")
    (tmp_path / "my_line.yaml").write_text(own, encoding="utf-8")
    # a name of the package is not replaced
    (tmp_path / "dsl.yaml").write_text(own, encoding="utf-8")
    code = (
        "from telenano.settings.network_profiles import PROFILES, profile_named\n"
        "print(profile_named('my_line').about == PROFILES['lte'].about, PROFILES['dsl'].about == PROFILES['lte'].about)"
    )
    environment = {**os.environ, "TELENANO_NETWORKS": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"]
