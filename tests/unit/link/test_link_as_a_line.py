"""What the link injects is what a line does: traces by number, bursts in time, order over all topics of a direction."""

import random
from pathlib import Path

import numpy as np
import pytest

from telenano.link.direction import DirectionEngine
from telenano.link.fate import Fate
from telenano.settings.link_settings import LinkSettings
from telenano.wire.errors import ConfigError

MS, NS = 1_000_000, 1_000_000_000
SAMPLES, LAW = "teleop/backward", "law/status"


def carried(section: dict[str, object], messages: list[tuple[int, str]], folder: Path = Path()) -> list[Fate]:
    """Give the fates of messages (time of arrival [ns], topic), in their order."""
    engine = DirectionEngine("backward", LinkSettings.of({"backward": section, "seed": 3}), 0, folder=folder)
    for seq, (now_ns, topic) in enumerate(messages):
        engine.submit(now_ns, topic, bytes(300), seq)
    while (next_ns := engine.next_release_ns()) is not None:
        engine.due(next_ns)
    return sorted(engine.take_fates(), key=lambda fate: fate.seq)


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """Give the greatest distance between two distributions (Kolmogorov, Smirnov)."""
    places = np.sort(np.concatenate([one, other]))
    shares = [np.searchsorted(np.sort(values), places, side="right") / len(values) for values in (one, other)]
    return float(np.abs(shares[0] - shares[1]).max())


def write(folder: Path, delays_ms: list[float], lost: set[int]) -> dict[str, object]:
    count = len(delays_ms)
    rows = [f"{number} {delays_ms[number] * 1e-3:.6f}" for number in range(count) if number not in lost]
    (folder / "a.delay").write_text("\n".join([*rows, f"{count} {rows[0].split()[1]}"]))
    (folder / "a.loss").write_text("\n".join([*(f"{n} {int(n in lost)}" for n in range(count)), f"{count} 0"]))
    return {"delay_trace": {"file": "a.delay", "by": "number"}, "loss_trace": {"file": "a.loss", "by": "number"}}


@pytest.mark.parametrize("spacing_us", [200, 1000, 3700])
def test_a_trace_by_number_keeps_neighbours_and_runs_at_any_rate(tmp_path: Path, spacing_us: int) -> None:
    draw = random.Random(1)
    delays_ms = [20.0 + 8.0 * draw.random() for _ in range(300)]
    lost = {number for begin in range(10, 300, 50) for number in range(begin, begin + draw.randint(1, 4))}
    section = write(tmp_path, delays_ms, lost)
    topics = (SAMPLES, LAW, "session/event")
    messages = [(spacing_us * 1000 * turn, topics[turn % 3]) for turn in range(1200)]
    fates = carried(section, messages, tmp_path)
    counted = [fate for fate in fates if fate.topic != "session/event"]
    # two turns of the trace and more; what is carried reliably does not count, and nothing of it is lost
    assert [fate.dropped == "loss_trace" for fate in counted] == [n % 300 in lost for n in range(len(counted))]
    found = [fate.delay_ns for fate in counted if not fate.dropped]
    assert found == [round(1e6 * round(delays_ms[n % 300], 3)) for n in range(len(counted)) if n % 300 not in lost]
    assert {fate.dropped for fate in fates if fate.topic == "session/event"} == {""}


def test_a_number_that_is_none_is_refused_with_file_and_line(tmp_path: Path) -> None:
    section = write(tmp_path, [20.0] * 10, set())
    (tmp_path / "a.delay").write_text("0 0.02\n1.5 0.02\n")
    with pytest.raises(ConfigError, match=r"backward\.delay_trace\.file: a\.delay, line 2: by number, .* whole number"):
        carried(section, [(0, SAMPLES)], tmp_path)


def wire_losses(packets: int, share: float, mean: float) -> np.ndarray:
    """Give which packets a line with bursts loses (Gilbert, Elliott), whatever they carry."""
    draw, bad, lost = random.Random(7), False, []
    r = 1.0 / mean
    p = r * share / (1.0 - share)
    for _ in range(packets):
        lost.append(bad)
        bad = draw.random() >= r if bad else draw.random() < p
    return np.array(lost)


def runs(lost: np.ndarray) -> np.ndarray:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    return edges[1::2] - edges[::2]


@pytest.mark.check("takes 2.8 s")
def test_bursts_in_ms_are_those_of_a_line_over_all_topics() -> None:
    # bursts of 30 packets of 3000 a second: a sample, a state of the law and another packet in each millisecond
    lost = wire_losses(3 * 60_000, 0.05, 30.0)
    section = {"outage": {"mean_up_s": 0.19, "mean_down_s": 0.01}}
    messages = [(turn * MS // 2, (SAMPLES, LAW)[turn % 2]) for turn in range(120_000)]
    fates = carried(section, messages)
    for place, topic in enumerate((SAMPLES, LAW)):
        on_wire = lost[place::3]
        injected = np.array([fate.dropped != "" for fate in fates if fate.topic == topic])
        assert injected.mean() == pytest.approx(0.05, abs=0.01)
        assert on_wire.mean() == pytest.approx(0.05, abs=0.01)
        assert runs(injected).mean() == pytest.approx(runs(on_wire).mean(), rel=0.15)
        assert distance(runs(injected), runs(on_wire)) < 0.15
    # by message of a topic a burst of 30 is three times as long
    by_message = {"gilbert_elliott": {"p": 0.05 / 0.95 / 30.0, "r": 1.0 / 30.0}}
    alone = np.array([fate.dropped != "" for fate in carried(by_message, messages) if fate.topic == SAMPLES])
    assert runs(alone).mean() > 2.5 * runs(lost[::3]).mean()


@pytest.mark.check("takes 1.1 s")
def test_jitter_in_order_is_that_of_a_line_over_all_topics() -> None:
    # the wire: each packet has a delay of its own and waits for those before it
    draw = random.Random(2)
    messages = [(turn * MS // 2, (SAMPLES, LAW)[turn % 2]) for turn in range(40_000)]
    latest, on_wire = 0, []
    for now_ns, topic in messages:
        latest = max(latest, now_ns + round((20.0 + draw.uniform(-10.0, 10.0)) * MS))
        if topic == SAMPLES:
            on_wire.append((latest - now_ns) / MS)
    found = {}
    for order in ("link", "topic"):
        jitter = {"distribution": "uniform", "scale_s": 0.01}
        fates = carried({"delay_s": 0.02, "jitter": jitter, "order": order}, messages)
        found[order] = np.array([fate.delay_ns / MS for fate in fates if fate.topic == SAMPLES])
    assert distance(found["link"], np.array(on_wire)) < 0.05
    assert distance(found["topic"], np.array(on_wire)) > 0.2


def test_outages_in_session_time_wait_for_the_session_and_begin_anew_with_each() -> None:
    settings = LinkSettings.of(
        {"forward": {"outage": {"schedule": [[1.0, 0.5]], "origin": "session", "period_s": 4.0}}}
    )
    engine = DirectionEngine("forward", settings, 0)
    dropped = []
    for turn in range(200):
        if turn in (50, 120):
            engine.begin_session(turn * NS // 10)
        engine.submit(turn * NS // 10, "teleop/forward", b"x", turn)
        engine.due(turn * NS // 10)
    dropped = [fate.seq for fate in engine.take_fates() if fate.dropped == "outage"]
    # a second after each start, and again after each period of four
    assert dropped == [begin + turn for begin in (60, 100, 130, 170) for turn in range(5)]


def test_a_change_of_other_settings_in_a_session_keeps_its_time() -> None:
    outage = {"schedule": [[1.0, 0.5]], "origin": "session"}
    engine = DirectionEngine("forward", LinkSettings.of({"forward": {}}), 0)
    engine.begin_session(5 * NS)
    settings = LinkSettings.of({"forward": {"outage": outage}})
    engine.adopt(settings, engine.files_of(settings), 5 * NS + NS // 2)
    engine.submit(6 * NS - 1, "teleop/forward", b"x", 0)
    engine.submit(6 * NS, "teleop/forward", b"x", 1)
    assert [fate.dropped for fate in sorted(engine.take_fates(), key=lambda fate: fate.seq)] == ["", "outage"]


def test_a_link_that_is_simulated_begins_with_the_session() -> None:
    settings = LinkSettings.of({"forward": {"outage": {"schedule": [[0.5, 0.1]], "origin": "session"}}})
    fates = DirectionEngine.fates(settings, "forward", "teleop/forward", range(7 * NS, 8 * NS, NS // 100), 300)
    assert [fate.seq for fate in fates if fate.dropped] == list(range(50, 60))
