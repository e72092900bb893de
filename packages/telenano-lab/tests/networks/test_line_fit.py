"""A log of a line becomes a model: known parameters are found again, and what it generates is like the log."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import special
from telenano_lab.networks import line_log, measured_lines
from telenano_lab.networks.line_draws import delays_ns
from telenano_lab.networks.line_fit import (
    SHARES,
    accept,
    ages_s,
    fit,
    generated,
    intervals,
    lost_runs,
    memory_of,
    parameters,
    statistics,
)
from telenano_lab.networks.line_log import LineLog, Segment, read_log
from telenano_lab.networks.line_page import SLOWER
from telenano_lab.networks.line_tally import correlation_of, scale_of, tally_of

from telenano.link import Direction, DirectionEngine
from telenano.recording import FileSettings, RecordingWriter
from telenano.serving import web_folder
from telenano.settings import LinkSettings, Profile, validate
from telenano.testing import invoke
from telenano.wire import ConfigError, LinkFate, LinkFates, encode

FOLDER = web_folder() / "gallery"
WAYS: tuple[Direction, ...] = ("forward", "backward")
PERIOD_S, TIME_S, PER_S, STALL_S, SPREAD = 0.02, 0.08, 0.1, 0.3, 0.2
TRUTH = {
    "usual delay, q50 [ms]": 20.0,
    "usual delay, q99 [ms]": 20.0 * math.exp(0.1 * 2.3263),
    "correlation time [ms]": 1e3 * TIME_S,
    "stalls per minute": 60.0 * PER_S,
    "length of a stall [ms]": 1e3 * STALL_S,
    "spread of its logarithm": SPREAD,
    "lost": 0.02,
    "lost in a row": 2.0,
}


def made_log(seed: int, seconds: float = 600.0) -> LineLog:
    """Make a log by another program than the link's: log-normal delays in time, stalls that hold, runs of losses."""
    draw = np.random.default_rng(seed)
    count = int(seconds / PERIOD_S)
    sent_s = PERIOD_S * np.arange(count)
    rho, fresh = math.exp(-PERIOD_S / TIME_S), draw.standard_normal(count)
    scores = np.empty(count)
    scores[0] = fresh[0]
    for n in range(1, count):
        scores[n] = rho * scores[n - 1] + math.sqrt(1.0 - rho * rho) * fresh[n]
    leaves_s = sent_s.copy()
    at_s = draw.exponential(1.0 / PER_S)
    while at_s < seconds:
        end_s = at_s + STALL_S * math.exp(SPREAD * draw.standard_normal() - 0.5 * SPREAD**2)
        leaves_s = np.where((sent_s >= at_s) & (sent_s < end_s), end_s, leaves_s)
        at_s = end_s + draw.exponential(1.0 / PER_S)
    arrived_s = np.maximum.accumulate(leaves_s + 0.020 * np.exp(0.1 * scores))
    delay_s = arrived_s - sent_s
    bad = False
    for n in range(count):
        bad = draw.random() < (0.5 if bad else 0.5 * 0.02 / 0.98)
        if bad:
            delay_s[n] = np.nan
    return LineLog((Segment(sent_s, delay_s),), round_trip=False)


def test_known_parameters_are_found_again() -> None:
    found = parameters(fit(made_log(1, 3000.0)))
    for what, share in zip(TRUTH, (0.01, 0.02, 0.06, 0.2, 0.05, 0.2, 0.15, 0.1), strict=True):
        assert found[what] == pytest.approx(TRUTH[what], rel=share), what


@pytest.mark.endurance  # 200 draws with a bootstrap each
@pytest.mark.timeout(3000)
def test_the_intervals_hold_the_truth() -> None:
    inside = dict.fromkeys(TRUTH, 0)
    for seed in range(200):
        bounds = intervals(made_log(seed), resamples=400)
        for what, value in TRUTH.items():
            inside[what] += bounds[what][0] <= value <= bounds[what][1]
    # Of 200 draws with a share of 95 % fewer than 180 are inside in two of a thousand cases, 99 % in one of a hundred
    # of eight parameters.
    assert min(inside.values()) >= 180, inside


def test_the_correlation_of_scores_is_found_from_that_of_the_delays() -> None:
    # of log-normal delays exp(s z) it is (exp(s^2 r) - 1) / (exp(s^2) - 1) in closed form
    spread, period_s = 0.5, 0.02
    shares = np.array(SHARES)
    shares[[0, -1]] = 1e-5, 1.0 - 1e-5
    quantiles_s = 0.02 * np.exp(spread * special.ndtri(shares))
    for time_s in (0.01, 0.05, 0.5, 5.0):
        wanted = math.expm1(spread**2 * math.exp(-period_s / time_s)) / math.expm1(spread**2)
        # the quantiles are linear between the shares
        assert memory_of(np.array([1]), [wanted], quantiles_s, period_s) == (pytest.approx(time_s, rel=0.02), 0.0, 0.0)
    for none in (0.01, math.nan):
        assert memory_of(np.array([1]), [none], quantiles_s, period_s) == (0.0, 0.0, 0.0)
    # a part that lasts for 2 s, and the rest for less than a period
    lags = 2 ** np.arange(9)
    scores = 0.3 * np.exp(-lags * period_s / 2.0)
    wanted = (np.expm1(spread**2 * scores) / math.expm1(spread**2)).tolist()
    time_s, second_s, share = memory_of(lags, wanted, quantiles_s, period_s)
    assert (time_s, share) == (pytest.approx(2.0, rel=0.2), pytest.approx(0.7, abs=0.03))
    assert second_s < period_s


def test_a_resample_is_tallied_as_the_log_of_its_blocks() -> None:
    log = made_log(6, 200.0)
    scale = scale_of(log)
    tally = tally_of(log, scale)
    assert len(tally.seconds) == 10
    (weights,) = tally.draws(3, 1)
    (part,) = log.segments
    block = np.minimum((part.sent_s / (part.sent_s[-1] / 10)).astype(int), 9)
    known = ~np.isnan(part.delay_s)
    taken = np.repeat(part.delay_s[known], weights[block[known]])
    shares = (0.0, 0.31, 0.5, 0.99, 1.0)
    np.testing.assert_allclose(tally.known.quantiles_s(weights, shares), np.quantile(taken, shares), rtol=1e-12)
    both = known[:-1] & known[1:]
    pairs = [np.repeat(values[both], weights[block[:-1][both]]) for values in (part.delay_s[:-1], part.delay_s[1:])]
    assert correlation_of(tally.pairs, weights) == pytest.approx(np.corrcoef(*pairs)[0, 1], rel=1e-9)
    assert weights @ tally.lost == np.repeat(~known, weights[block]).sum()
    assert weights.sum() == 10


def test_what_is_generated_is_like_the_half_that_the_fit_has_not_seen() -> None:
    table = accept(made_log(2))
    assert sum(row.agrees for row in table) >= len(table) - 1, table
    assert len(table) == 13


def test_a_model_without_the_stalls_is_seen_to_disagree() -> None:
    log = made_log(3)
    scale = scale_of(log)
    without = fit(log).__class__(**{**vars(fit(log)), "stalls_per_s": 0.0})
    measured, other = statistics(log, scale), statistics(generated(without.ways(round_trip=False), log, 1), scale)
    assert measured["q99.9 [ms]"] > 3.0 * other["q99.9 [ms]"]
    assert other["stalls per minute"] == 0.0 < measured["stalls per minute"]


def test_a_round_trip_becomes_two_ways_whose_delays_add_up_to_it() -> None:
    (part,) = made_log(4).segments
    log = LineLog((part,), round_trip=True)
    ways = fit(log).ways(round_trip=True)
    settings = LinkSettings.of({"seed": 3, **ways})
    # the engine itself, there and then back at the times of arrival
    times_ns = [round(1e9 * t) for t in part.sent_s.tolist()]
    there = [one for one in DirectionEngine.fates(settings, "forward", "udp", times_ns, 200) if not one.dropped]
    arrived_ns = sorted(one.arrived_ns + one.delay_ns for one in there)
    back = DirectionEngine.fates(settings, "backward", "udp", arrived_ns, 200)
    sums = 1e-9 * (np.sort([one.delay_ns for one in there]) + np.array([one.delay_ns for one in back]))
    measured = part.delay_s[~np.isnan(part.delay_s)]
    for share, within in ((0.05, 0.02), (0.5, 0.02), (0.9, 0.03), (0.99, 0.25)):
        assert np.quantile(sums, share) == pytest.approx(np.quantile(measured, share), rel=within), share
    assert len(there) / len(times_ns) == pytest.approx(len(measured) / len(times_ns), abs=0.01)


def table_of(path: Path, headings: str = "sent_ms,received_ms", seconds: float = 60.0, seed: int = 5) -> Path:
    (part,) = made_log(seed, seconds).segments
    rows = [
        f"{1e3 * sent:.3f},{'' if math.isnan(delay) else f'{1e3 * (sent + delay):.3f}'}"
        for sent, delay in zip(part.sent_s.tolist(), part.delay_s.tolist(), strict=True)
    ]
    path.write_text("\n".join([headings, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize("headings", ["sent_ms,received_ms", "pub_time(ms),sub_time(ms)", "tx [ms],rx [ms]"])
def test_a_table_is_read_by_its_headings(tmp_path: Path, headings: str) -> None:
    (part,) = read_log([table_of(tmp_path / "log.csv", headings)]).segments
    (made,) = made_log(5, 60.0).segments
    assert part.sent_s == pytest.approx(made.sent_s, abs=1e-6)
    assert part.delay_s == pytest.approx(made.delay_s, abs=2e-6, nan_ok=True)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda text: text.replace("sent_ms,received_ms", "sent,received"), "sent does not say its unit.*--unit ms"),
        (lambda text: text.split("\n", 1)[1], "line 1: has no headings"),
        (lambda text: text.replace("received_ms", "colour"), "has the columns sent_ms, colour; a column of times"),
        (lambda text: text.replace("\n20.000,", "\n20.000,19.0\n20.000,", 1), "line 3: was received 0.001 s before"),
        (lambda text: text.replace("\n40.000,", "\n40.000,x", 1), "line 4: 'x.*is not a number"),
        (
            lambda text: "\n".join(text.split("\n")[:200]),
            "198 messages in 3.9. s are too few.* is the unit",
        ),
        (lambda text: text.replace("_ms", "_ns"), "3000 messages in 6e-05 s are too few"),
    ],
)
def test_a_log_that_cannot_serve_is_refused_in_words(tmp_path: Path, change, reason: str) -> None:  # type: ignore[no-untyped-def]
    path = table_of(tmp_path / "log.csv")
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(ConfigError, match=reason):
        read_log([path])


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_units_of_other_campaigns_give_the_same_model(tmp_path: Path, unit: str) -> None:
    # Times since 1970 in nanoseconds, a mark of the order of bytes and line ends of another system, as loggers write.
    (part,) = made_log(5, 60.0).segments
    scale, digits = {"s": (1, 6), "ms": (1e3, 3), "us": (1e6, 0), "ns": (1e9, 0)}[unit]
    rows = [f"timestamp_{unit};latency_ms"]
    for sent_s, delay_s in zip(part.sent_s.tolist(), part.delay_s.tolist(), strict=True):
        rows.append(f"{(1.7e9 + sent_s) * scale:.{digits}f};{'' if math.isnan(delay_s) else 1e3 * delay_s}")
    path = tmp_path / "log.csv"
    path.write_bytes(("\ufeff" + "\r\n".join([*rows, ""])).encode())
    found, wanted = parameters(fit(read_log([path]))), parameters(fit(made_log(5, 60.0)))
    for what, value in wanted.items():
        assert found[what] == pytest.approx(value, rel=1e-3, nan_ok=True), what


@pytest.mark.parametrize("after_s", [10.0, 20.0, 50.0])
def test_a_clock_that_stepped_anywhere_in_the_log_is_refused(tmp_path: Path, after_s: float) -> None:
    (part,) = made_log(5, 60.0).segments
    path = tmp_path / "log.csv"
    arrived_s = part.sent_s + part.delay_s + 0.5 * (part.sent_s > after_s)
    rows = [f"{1e3 * s},{'' if math.isnan(r) else 1e3 * r}" for s, r in zip(part.sent_s, arrived_s, strict=True)]
    path.write_text("\n".join(["sent_ms,received_ms", *rows, ""]), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"median delay is (19|20)\.\d+ ms .* 520.* ms after them.*in one step near"):
        read_log([path])


@pytest.mark.parametrize(
    ("heading", "is_trip"),
    [("rtt_ms", True), ("avg_rtt (ms)", True), ("latency_rtt_ms", True), ("srtt_ms", True), ("2-way delay [ms]", True),
     ("Round Trip Time [ms]", True), ("ping [ms]", True), ("delay_ms", False), ("owd [ms]", False),
     ("latency (ms)", False)],
)  # fmt: skip
def test_a_heading_says_whether_its_delays_are_round_trips(heading: str, is_trip: bool, tmp_path: Path) -> None:
    rows = "".join(f"{0.2 * n:.1f},{40 + n % 7}\n" for n in range(600))
    (tmp_path / "log.csv").write_text(f"ts_s,{heading}\n{rows}", encoding="utf-8")
    log = read_log([tmp_path / "log.csv"])
    assert log.round_trip is is_trip
    assert any("round trips" in cut for cut in log.cuts) is is_trip


def test_a_line_that_changes_now_and_then_is_no_clock_that_stepped(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    level = ("20", "24", "21", "28", "20", "26")
    rows = [f"{20 * n},{level[n // 200 % 6]}.{n % 10}" for n in range(6000)]
    path.write_text("\n".join(["sent_ms,delay_ms", *rows, ""]), encoding="utf-8")
    assert len(read_log([path]).segments) == 1


def test_each_place_of_a_log_is_looked_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shares: list[float] = []
    monkeypatch.setattr(line_log, "_check_level", lambda part, share: shares.append(share))
    read_log([table_of(tmp_path / "log.csv")])
    assert shares[0] == 0.5
    assert sorted(shares) == pytest.approx([n / 20 for n in range(1, 20)])
    shares.clear()
    read_log([table_of(tmp_path / "log.csv")], round_trip=True)
    assert shares == [0.5]


def test_rows_that_are_not_in_order_are_refused_and_half_a_line_is_left_out(tmp_path: Path) -> None:
    path = table_of(tmp_path / "log.csv")
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.index("\n40000.000,") + 14], encoding="utf-8")
    log = read_log([path])
    assert len(log.segments[0].sent_s) == 2000
    assert "its last line has no end" in log.cuts[0]
    head, *rows = text.splitlines()
    rows[::7], rows[1::7] = rows[1::7], rows[: len(rows[1::7]) * 7 : 7]
    path.write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    with pytest.raises(ConfigError, match="goes back 429 times; its rows are not in the order of sending, so sort"):
        read_log([path])


def test_a_unit_that_was_guessed_wrong_is_said(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("sent_ms,delay_s\n" + "".join(f"{20 * n},{200 + n % 3}\n" for n in range(3000)), encoding="utf-8")
    with pytest.raises(ConfigError, match="the median delay would be 201 s; is the unit of the column right"):
        read_log([path])


def test_a_clock_that_steps_back_and_a_pause_cut_the_log(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    times = [*range(0, 20_000, 20), *range(15_000, 40_000, 20), *range(90_000, 120_000, 20)]
    path.write_text("sent_ms,delay_ms\n" + "".join(f"{t},20\n" for t in times), encoding="utf-8")
    log = read_log([path])
    assert [len(part.sent_s) for part in log.segments] == [1000, 1250, 1500]
    assert [word in " ".join(log.cuts) for word in ("stepped back 1 times", "after message 1000", "nothing was sent")]
    assert log.resolution_s == 0.01


def test_a_log_whose_level_changes_or_that_no_packet_answered_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("sent_ms,delay_ms\n" + "".join(f"{20 * n},{20 + n % 5 + 30 * (n > 1500)}\n" for n in range(3000)))
    with pytest.raises(ConfigError, match=r"not stationary: its median delay is 22 ms .* 52 ms after them"):
        read_log([path])
    silent = tmp_path / "ping.txt"
    silent.write_text("PING 192.0.2.1 (192.0.2.1) 56(84) bytes of data.\n")
    with pytest.raises(ConfigError, match=r"ping.txt: is a log of ping without an answer"):
        read_log([silent])


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_a_recording_of_a_link_is_read_with_what_its_link_did(tmp_path: Path, direction: str, recorded) -> None:  # type: ignore[no-untyped-def]
    path = recorded(tmp_path / "line.mcap")
    log = read_log([path], direction=direction)
    (part,) = log.segments
    assert len(part.sent_s) == 4000
    assert np.nanmedian(part.delay_s) == pytest.approx({"forward": 0.02, "backward": 0.005}[direction], abs=1e-3)
    assert np.isnan(part.delay_s).mean() == pytest.approx(0.1, abs=0.03)
    assert "what the link did to udp" in log.cuts[0]


@pytest.fixture
def recorded():  # type: ignore[no-untyped-def]
    """Return what writes a recording with the fates of a link at 100 Hz, as the link reports them."""

    def write(path: Path) -> Path:
        ways = {
            name: {"delay_s": delay_s, "jitter": {"scale_s": 1e-4}, "loss": {"probability": 0.1}}
            for name, delay_s in (("forward", 0.02), ("backward", 0.005))
        }
        settings = LinkSettings.of(ways)
        writer = RecordingWriter.create("recorder@master", FileSettings(directory=path.parent, file_name=path.name))
        channel = writer.channel("link/fates", "delay_node@master", "master")
        for way in WAYS:
            rows = [
                LinkFate(
                    topic="udp", seq=fate.seq, is_duplicate=False, arrived_ns=fate.arrived_ns, delay_ns=fate.delay_ns,
                    queue_ns=0, held_ns=0, dropped=fate.dropped, duplicated=False, reordered=False, corrupted=False,
                )
                for fate in DirectionEngine.fates(settings, way, "udp", range(10**9, 41 * 10**9, 10**7), 100)
            ]  # fmt: skip
            for first in range(0, len(rows), 1000):
                number = WAYS.index(way) * 10 + first // 1000
                part = {"direction": way, "fates": tuple(rows[first : first + 1000])}
                message = LinkFates(seq=number, t_ns=10**9 + number, src="delay_node@master", v=1, **part)
                writer.write(channel, 10**9 + number, 10**9 + number, number, encode(message))
        writer.finish()
        return path

    return write


def test_a_delivery_trace_is_what_small_messages_would_have_met(tmp_path: Path) -> None:
    path = tmp_path / "lte.down"
    # an opportunity each 4 ms, and none between 20 and 22 s
    path.write_text("".join(f"{n}\n" for n in range(4, 60_000, 4) if not 20_000 < n < 22_000))
    log = read_log([path])
    (part,) = log.segments
    assert (len(part.sent_s), log.period_s) == (5999, pytest.approx(0.01))
    assert float(np.nanmax(part.delay_s)) == pytest.approx(1.99, abs=0.02)
    assert float(np.median(part.delay_s)) <= 0.004
    model = fit(log)
    assert model.stalls_per_s == pytest.approx(1.0 / 60.0, rel=0.1)
    assert "Messages of 200 bytes each 10 ms were sent through it" in log.cuts[0]


def test_a_histogram_becomes_a_profile_that_says_that_no_memory_is_known(tmp_path: Path) -> None:
    path = tmp_path / "bins.csv"
    path.write_text("3.0,5\n4.0,90\n5.0,5\n6.0,0\n")
    done = invoke(["link", "fit", str(path), "--histogram", "--out", str(tmp_path / "line")])
    assert done.exit_code != 0
    assert "does not say the unit of its bins; give --unit ms" in done.stderr
    command = ["link", "fit", str(path), "--histogram", "--unit", "ms", "--out", str(tmp_path / "line")]
    done = invoke(command)
    assert done.exit_code == 0, done.output
    assert "No memory known" in done.output
    profile = yaml.safe_load((tmp_path / "line" / "profile.yaml").read_text(encoding="utf-8"))
    assert profile["about"] == "a measured line (no memory known)"
    assert profile["statistics"]["forward"]["percentiles_ms"][50] == pytest.approx(4.5, abs=0.02)
    path.write_text("bin_ms,count\n3.0,5\n2.0,5\n")
    done = invoke(["link", "fit", str(path), "--histogram", "--out", str(tmp_path / "line")])
    assert "bins.csv, line 3: the bins have to rise" in done.stderr


def test_the_age_at_a_reader_is_that_of_the_newest_message_and_grows_through_a_stall() -> None:
    sent_s = 0.1 * np.arange(100)
    delay_s = np.full(100, 0.02)
    # the messages of 5.0 to 5.9 s come together at 6.0 s
    delay_s[50:60] = 6.0 - sent_s[50:60]
    delay_s[70] = np.nan
    ages = ages_s(LineLog((Segment(sent_s, delay_s),), round_trip=False), count=9000)
    assert (ages.min(), ages.max()) == (pytest.approx(0.02, abs=2e-3), pytest.approx(1.1, abs=2e-3))
    assert lost_runs(LineLog((Segment(sent_s, delay_s),), round_trip=False)) == [1]


def test_the_command_writes_settings_profile_and_page(tmp_path: Path) -> None:
    log = table_of(tmp_path / "log.csv", seconds=120.0)
    done = invoke(["link", "fit", str(log), "--out", str(tmp_path / "line"), "--cite", "our own", "--anyway"])
    assert done.exit_code in (0, 3), done.output
    assert "stalls per minute" in done.output
    way = json.loads((tmp_path / "line" / "way.json").read_text(encoding="utf-8"))
    settings = LinkSettings.of({"forward": way})
    assert settings.forward.outage.mode == "hold"
    assert settings.forward.jitter.correlation_time_s == pytest.approx(TIME_S, rel=0.3)
    profile = yaml.safe_load((tmp_path / "line" / "profile.yaml").read_text(encoding="utf-8"))
    assert validate(Profile, profile, "profile.yaml").round_trip_ms > 40.0
    done = invoke(["link", "fit", str(log), "--out", str(tmp_path / "twin"), "--without-memory", "--anyway"])
    twin = yaml.safe_load((tmp_path / "twin" / "profile.yaml").read_text(encoding="utf-8"))
    assert twin["statistics"]["forward"]["mean_ms"] == pytest.approx(
        profile["statistics"]["forward"]["mean_ms"], rel=0.1
    )
    assert "outage" not in twin["link"]["forward"]
    assert "data:image/png" in (tmp_path / "line" / "fit.html").read_text(encoding="utf-8")


@pytest.mark.check("fits and draws a log of four minutes with each option")
@pytest.mark.drawn(0.4)
@pytest.mark.parametrize(
    "options", [(), ("--without-memory",), ("--round-trip",), ("--round-trip", "--without-memory"), ("--seed", "7")]
)
def test_what_is_judged_is_drawn_from_the_settings_that_are_written(options: tuple[str, ...], tmp_path: Path) -> None:
    # both halves are the same, so that the model of the first is that of all
    (part,) = made_log(3, 120.0).segments
    times_s = np.concatenate([part.sent_s, 120.0 + part.sent_s])
    rows = zip((1e3 * times_s).tolist(), (1e3 * np.tile(part.delay_s, 2)).tolist(), strict=True)
    path = tmp_path / "log.csv"
    text = "".join(f"{sent:.3f},{'' if math.isnan(delay) else f'{delay:.6f}'}\n" for sent, delay in rows)
    path.write_text(f"sent_ms,delay_ms\n{text}", encoding="utf-8")
    done = invoke(["link", "fit", str(path), "--out", str(tmp_path / "line"), "--anyway", *options])
    assert done.exit_code in (0, 3), done.output
    document = json.loads((tmp_path / "line" / "fit.json").read_text(encoding="utf-8"))
    judged = {row["what"]: row["generated"] for row in document["agreement"]}
    log = read_log([path], round_trip="--round-trip" in options)
    written = yaml.safe_load((tmp_path / "line" / "profile.yaml").read_text(encoding="utf-8"))["link"]
    draws = [statistics(generated(written, log.halves()[1], seed), scale_of(log)) for seed in range(25)]
    for what, within in (("q50 [ms]", 0.03), ("q99 [ms]", 0.2), ("lost", 0.1), ("stalls per minute", 0.3)):
        assert judged[what] == pytest.approx(np.median([one[what] for one in draws]), rel=within, abs=0.1), what
    neighbours = float(np.median([one["correlation of neighbours"] for one in draws]))
    assert judged["correlation of neighbours"] == pytest.approx(neighbours, abs=0.05)
    is_alone = "--without-memory" in options
    assert (neighbours < 0.1) == is_alone
    row = next(row for row in document["agreement"] if row["what"] == "correlation of neighbours")
    assert row["agrees"] != is_alone


def test_networks_are_drawn_with_the_age_at_a_reader(tmp_path: Path) -> None:
    command = ["link", "picture", "starlink_driving", "clean", "--out", str(tmp_path / "p"), "--json"]
    done = invoke(command)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["networks"]
    assert found["clean"]["delay_ms"] == {"p50": 0.0, "p99": 0.0}
    assert found["clean"]["age_ms"]["p99"] == pytest.approx(5.0, abs=0.2)
    # a reader of the newest sees the delay and half a period
    starlink = found["starlink_driving"]
    assert starlink["delay_ms"]["p50"] < starlink["age_ms"]["p50"] < starlink["delay_ms"]["p50"] + 10.0
    for picture in ("networks", "starlink_driving", "clean"):
        assert (tmp_path / "p" / f"{picture}.png").read_bytes().startswith(b"\x89PNG")
    curves = json.loads((tmp_path / "p" / "networks.json").read_text(encoding="utf-8"))
    assert curves["networks"]["clean"]["memory"][1][0] is None
    half = curves["slower"].index(0.5)
    assert curves["networks"]["starlink_driving"]["age_ms"][half] == pytest.approx(starlink["age_ms"]["p50"], rel=0.01)
    # the page of the operator has the same
    shipped = json.loads((FOLDER / "networks.json").read_text(encoding="utf-8"))
    assert shipped["slower"] == curves["slower"]
    for what in ("delay_ms", "age_ms"):
        found = curves["networks"]["starlink_driving"][what]
        assert shipped["networks"]["starlink_driving"][what] == pytest.approx(found, rel=0.02), what
    refused = invoke(["link", "picture", "mars", "--out", str(tmp_path / "p")])
    assert "unknown profile 'mars'" in refused.stderr


def test_the_page_has_the_curves_of_every_measured_network() -> None:
    shipped = json.loads((FOLDER / "networks.json").read_text(encoding="utf-8"))["networks"]
    assert {name.lower() for name in measured_lines.LINES} <= shipped.keys()
    for name, curves in shipped.items():
        assert len(curves["delay_ms"]) == len(curves["age_ms"]) == len(SLOWER), name
        assert len({len(one) for one in curves["course"]}) == 1, name
        assert curves["delay_ms"] == sorted(curves["delay_ms"])


def test_the_measured_lines_and_their_twins_are_written_where_the_profiles_are() -> None:
    folder = Path(__file__).parents[4] / measured_lines.PROFILES
    twins = {f"{name}_no_memory" for name, line in measured_lines.LINES.items() if line.has_twin}
    assert {name.lower() for name in (*measured_lines.LINES, *twins)} <= {path.stem for path in folder.glob("*.yaml")}


LINES = [
    "cicv5g_n78_arterial", "cicv5g_n8_urban", "starlink_driving", "att_driving", "verizon_driving",
    "private_5g_mmwave", "urllc_mmwave", "att_driving_no_memory",
]  # fmt: skip


@pytest.mark.parametrize("name", LINES)
def test_the_delays_of_a_line_are_those_that_the_engine_gives(name: str) -> None:
    settings = LinkSettings.of({"profile": name, "seed": 3})
    # a minute, a pause after which nothing is left of a score, and what is sent while a stall lasts
    times_ns = [*range(5 * 10**9, 65 * 10**9, 2 * 10**7), *range(10**15, 10**15 + 120 * 10**9, 10**8)]
    fates = DirectionEngine.fates(settings, "forward", "udp", times_ns, 200)
    wanted = np.array([np.nan if fate.dropped else fate.delay_ns for fate in fates])
    np.testing.assert_allclose(delays_ns(settings, "udp", times_ns, 200), wanted, rtol=0, atol=1.0)


def test_a_stall_that_holds_more_than_the_queue_drops_as_the_engine_does() -> None:
    way = {
        "jitter": {"distribution": "table", "scale_s": 1.0, "quantiles": "0:0.01,1:0.02"},
        "queue": {"limit_messages": 40},
        "outage": {"mean_up_s": 1.0, "mean_down_s": 1.0, "down_spread": 0.1, "mode": "hold"},
    }
    settings = LinkSettings.of({"forward": way, "seed": 3})
    found = delays_ns(settings, "udp", range(0, 30 * 10**9, 10**7), 200)
    assert 0.1 < np.isnan(found).mean() < 0.5
