import math
from collections import Counter, defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link_bench import MS, START, TOPIC, engine, finish, stream

from telenano.link.direction import DirectionEngine
from telenano.link.engine import LinkEngine
from telenano.settings.link_settings import Impairment, LinkSettings
from telenano.wire.errors import ConfigError

# --- delay ---------------------------------------------------------------------------------------------------------


def test_without_impairment_a_message_comes_out_at_once():
    link = engine()
    (release,) = link.submit(START + 5, TOPIC, b"abc", 17)
    assert (release.topic, release.payload) == (TOPIC, b"abc")
    fate = release.fate
    assert (fate.direction, fate.topic, fate.seq, fate.copy, fate.size_bytes) == ("forward", TOPIC, 17, 0, 3)
    assert (fate.arrived_ns, fate.release_ns, fate.delay_ns, fate.dropped) == (START + 5, START + 5, 0, "")
    assert link.next_release_ns() is None
    assert link.take_fates() == [fate]
    assert link.take_fates() == []


def test_constant_delay_releases_to_the_nanosecond_and_in_order():
    link = engine(delay_s=0.02)
    for k in range(5):
        assert link.submit(START + k * MS, TOPIC, b"%d" % k, k) == ()
    assert link.next_release_ns() == START + 20 * MS
    assert link.due(START + 20 * MS - 1) == []
    assert [release.payload for release in link.due(START + 22 * MS)] == [b"0", b"1", b"2"]
    assert [release.fate.release_ns - START for release in link.due(START + 100 * MS)] == [23 * MS, 24 * MS]


def test_delay_trace_table_and_delivery_come_from_files(tmp_path):
    (tmp_path / "delay.txt").write_text("0 0.010\n1 0.020\n")
    fates = stream(1000, folder=tmp_path, delay_s=0.001, delay_trace={"file": "delay.txt"})
    assert [fate.delay_ns for fate in fates] == [11 * MS + k * 10_000 for k in range(1000)]
    (tmp_path / "table.txt").write_text("0.005\n")
    table = {"scale_s": 1.0, "distribution": "table", "table_file": "table.txt"}
    assert {fate.delay_ns for fate in stream(10, folder=tmp_path, jitter=table)} == {5 * MS}
    (tmp_path / "up.txt").write_text("3\n4\n10\n")
    delivery = {"file": "up.txt", "bytes_per_opportunity": 200}
    fates = stream(12, folder=tmp_path, delay_s=0.001, delivery_trace=delivery)
    # Two messages of 100 bytes an opportunity, then 1 ms of delay.
    times = [3, 3, 4, 4, 10, 10, 13, 13, 14, 14, 20, 20]
    assert [(fate.release_ns - START) // MS - 1 for fate in fates] == times
    assert [fate.queue_ns for fate in fates] == [(t - k) * MS for k, t in enumerate(times)]


def test_bad_trace_leaves_the_last_good_settings(tmp_path):
    (tmp_path / "bad.txt").write_text("0 0.01\n0 0.02\n")
    link = LinkEngine(LinkSettings.of({"forward": {"delay_s": 0.02}}), START, folder=tmp_path)
    with pytest.raises(ConfigError, match=r"^backward\.delay_trace\.file: bad\.txt, line 2: the time is not later"):
        link.reconfigure(link.settings.changed({"backward.delay_trace.file": "bad.txt", "forward.delay_s": 0.0}), START)
    with pytest.raises(ConfigError, match=r"^forward\.topics\.a\.delivery_trace\.file: .*gone\.txt: is not a file"):
        link.reconfigure(link.settings.changed({"forward.topics.a.delivery_trace.file": "gone.txt"}), START)
    assert link.settings.forward.delay_s == 0.02
    assert link.forward.submit(START, TOPIC, b"", 0) == ()
    assert link.next_release_ns() == START + 20 * MS


# --- loss, duplication, corruption, reordering ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("forward", "cause"),
    [
        ({"loss": {"probability": 1.0}}, "loss"),
        ({"markov_loss": {"p14": 1.0, "p13": 0.0}}, "markov_loss"),
        ({"gilbert_elliott": {"loss_in_good": 1.0}}, "gilbert_elliott"),
        ({"outage": {"schedule": "0:1"}}, "outage"),
        ({"rate": {"rate_bytes_per_s": 1.0}, "queue": {"limit_messages": 0}}, "queue"),
    ],
)
def test_drop_names_its_cause(forward, cause):
    fates = stream(4, **forward)
    dropped = [fate for fate in fates if fate.release_ns is None]
    assert {fate.dropped for fate in dropped} == {cause}
    assert all((fate.delay_ns, fate.queue_ns, fate.held_ns) == (0, 0, 0) for fate in dropped)
    assert all(fate.dropped == "" for fate in fates if fate.release_ns is not None)


def test_losses_combine_as_independent_ones():
    fates = stream(50_000, loss={"probability": 0.1}, gilbert_elliott={"loss_in_good": 0.2})
    share = np.mean([bool(fate.dropped) for fate in fates])
    assert abs(share - 0.28) < 4 * math.sqrt(0.28 * 0.72 / 50_000)


def test_duplicates_have_the_share_asked_for_and_a_delay_of_their_own():
    fates = stream(20_000, delay_s=0.1, jitter={"scale_s": 0.01}, duplication={"probability": 0.25})
    copies = [fate for fate in fates if fate.copy == 1]
    assert abs(len(copies) / 20_000 - 0.25) < 4 * math.sqrt(0.1875 / 20_000)
    originals = {fate.seq: fate for fate in fates if fate.copy == 0}
    assert {copy.seq for copy in copies} == {seq for seq, fate in originals.items() if fate.duplicated}
    pairs = np.array([[originals[copy.seq].delay_ns, copy.delay_ns] for copy in copies], dtype=float)
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / math.sqrt(len(copies))


@pytest.mark.check("takes 1.2 s")
@pytest.mark.parametrize("bits", [1, 5])
def test_corruption_flips_so_many_bits_anywhere(bits):
    link = engine(corruption={"probability": 0.5, "bits": bits})
    clean = bytes(range(64))
    flips = Counter()
    corrupted = 0
    for k in range(20_000):
        (release,) = link.submit(START + k, TOPIC, clean, k)
        wrong = int.from_bytes(release.payload) ^ int.from_bytes(clean)
        assert wrong.bit_count() == (bits if release.fate.corrupted else 0)
        corrupted += release.fate.corrupted
        flips.update(place for place in range(512) if wrong >> place & 1)
    assert abs(corrupted / 20_000 - 0.5) < 4 * math.sqrt(0.25 / 20_000)
    assert link.stats().corrupted == corrupted
    expected = corrupted * bits / 512
    chi_square = sum((flips[place] - expected) ** 2 / expected for place in range(512))
    assert chi_square < 511 + 4 * math.sqrt(2 * 511)


@pytest.mark.check("takes 0.9 s")
@pytest.mark.parametrize(("probability", "gap"), [(0.25, 1), (1.0, 5), (0.5, 4)])
def test_reordered_share_follows_from_probability_and_gap(probability, gap):
    fates = stream(50_000, delay_s=0.01, reordering={"probability": probability, "gap": gap})
    overtaking = [fate.reordered for fate in fates[10:]]
    assert all(fate.delay_ns in (0, 10 * MS) for fate in fates)
    assert all((fate.delay_ns == 0) == fate.reordered for fate in fates[10:])
    distance = gap - 1 + 1 / probability
    sigma = math.sqrt((1 - probability) / probability**2) / distance / math.sqrt(len(overtaking) * distance)
    assert abs(np.mean(overtaking) - 1 / distance) <= 4 * sigma + 2 / len(overtaking)
    places = np.flatnonzero(overtaking)
    assert np.diff(places).min() >= gap


@pytest.mark.parametrize("forward", [{}, {"order": "topic"}, {"loss": {"probability": 1e-9}}])
def test_messages_released_together_have_not_overtaken_each_other(forward):
    fates = stream(5, period_ns=1, delay_s=0.01, **forward)
    settings = LinkSettings.of({"forward": {"delay_s": 0.01, **forward}})
    together = DirectionEngine.fates(settings, "forward", TOPIC, [START] * 5, 9)
    assert not any(fate.reordered for fate in (*fates, *together))


def test_message_sent_past_the_queue_overtakes_those_that_wait():
    fates = stream(50, rate={"rate_bytes_per_s": 50_000.0}, reordering={"probability": 1.0, "gap": 10}, size=100)
    assert [fate.seq for fate in fates if fate.reordered] == [9, 19, 29, 39, 49]
    assert all(fate.queue_ns == 0 for fate in fates if fate.reordered)


@pytest.mark.parametrize("probability", [0.0, 0.3])
def test_settings_apply_to_the_share_asked_for(probability):
    fates = stream(20_000, delay_s=0.05, apply_probability=probability)
    share = np.mean([fate.delay_ns == 50 * MS for fate in fates])
    assert abs(share - probability) <= 4 * math.sqrt(probability * (1 - probability) / 20_000)
    assert {fate.delay_ns for fate in fates} <= {0, 50 * MS}


# --- order, rate, slots, outages -------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["topic", "link"])
def test_strict_order_lets_nobody_overtake(order):
    link = engine(order=order, delay_s=0.05, jitter={"scale_s": 0.03}, duplication={"probability": 0.2})
    for k in range(2000):
        link.submit(START + k * MS, f"t/{k % 3}", b"", k)
    released = finish(link)
    by_topic = defaultdict(list)
    for release in released:
        by_topic[release.topic].append(release.fate.seq)
    assert all(seqs == sorted(seqs) for seqs in by_topic.values())
    everything = [release.fate.seq for release in released]
    assert (everything == sorted(everything)) == (order == "link")
    assert link.stats().reordered == 0


def test_rate_limit_gives_the_throughput_and_the_queue_its_length():
    fates = stream(
        20_000, size=946, rate={"rate_bytes_per_s": 500_000.0, "overhead_bytes": 54}, queue={"limit_messages": 50}
    )
    passed = [fate for fate in fates if fate.release_ns is not None]
    # Twice the capacity arrives: half of it is dropped, the rest waits for 50 messages of 2 ms and its own.
    assert len(passed) / 20_000 == pytest.approx(0.5, rel=0.01, abs=0)
    assert {fate.dropped for fate in fates} == {"", "queue"}
    steady = [fate.queue_ns for fate in passed[200:]]
    # 50 waiting, one on the line that has at least half its time to go.
    assert min(steady) > 50 * 2 * MS
    assert max(steady) <= 52 * 2 * MS
    gaps = np.diff([fate.release_ns for fate in passed])
    assert (gaps == 2 * MS).all()


def test_one_line_serves_all_topics_under_the_same_settings_and_others_have_their_own():
    link = engine(rate={"rate_bytes_per_s": 1e5}, topics={"own/*": {"delay_s": 0.0}})
    for topic in ("a", "b", "own/a", "own/b"):
        link.submit(START, topic, bytes(100), 0)
    times = {release.topic: (release.fate.release_ns - START) // MS for release in finish(link)}
    assert times == {"a": 1, "b": 2, "own/a": 1, "own/b": 2}


def test_outage_begins_when_the_settings_come_into_force():
    link = LinkEngine(LinkSettings.of({}), START)
    link.reconfigure(link.settings.changed({"forward.outage.schedule": "0.01:0.01"}), START + 100 * MS)
    now = [START + 100 * MS + k * MS for k in range(30)]
    passed = [bool(link.forward.submit(at, TOPIC, b"", k)) for k, at in enumerate(now)]
    assert passed == [not 10 <= k < 20 for k in range(30)]
    # A change of another key does not move it.
    link.reconfigure(link.settings.changed({"forward.outage.schedule": "0.01:0.02"}), START + 200 * MS)
    link.reconfigure(link.settings.changed({"forward.outage.mode": "hold"}), START + 205 * MS)
    assert link.forward.submit(START + 212 * MS, TOPIC, b"", 0) == ()
    assert link.next_release_ns() == START + 230 * MS


# --- topics, directions, reliable ------------------------------------------------------------------------------------


def test_topics_and_directions_have_settings_of_their_own():
    link = LinkEngine(
        LinkSettings.of(
            {
                "forward": {
                    "delay_s": 0.01,
                    "topics": {"haptic/*": {"delay_s": 0.02}, "haptic/state": {"delay_s": 0.03}},
                },
                "backward": {"delay_s": 0.04},
            }
        ),
        START,
    )
    for topic in ("teleop/forward", "haptic/command", "haptic/state"):
        link.forward.submit(START, topic, b"", 0)
    link.backward.submit(START, "teleop/backward", b"", 0)
    delays = {(fate.direction, fate.topic): fate.delay_ns // MS for fate in link.take_fates()}
    assert delays == {
        ("forward", "teleop/forward"): 10,
        ("forward", "haptic/command"): 20,
        ("forward", "haptic/state"): 30,
        ("backward", "teleop/backward"): 40,
    }


HOSTILE = {
    "delay_s": 0.02,
    "jitter": {"scale_s": 0.01},
    "loss": {"probability": 0.5},
    "gilbert_elliott": {"p": 0.5, "r": 0.5},
    "markov_loss": {"p13": 0.3, "p31": 0.5},
    "corruption": {"probability": 0.5},
    "duplication": {"probability": 0.5},
    "reordering": {"probability": 0.5},
    "outage": {"mean_up_s": 0.1, "mean_down_s": 0.1},
    "rate": {"rate_bytes_per_s": 200_000.0},
    "queue": {"limit_messages": 3},
}


def test_session_topics_are_delayed_but_nothing_else_happens_to_them():
    link = engine(**HOSTILE)
    released = []
    for k in range(500):
        released += link.submit(START + k * MS, "session/control", b"stop%d" % k, k)
        released += link.submit(START + k * MS, TOPIC, bytes(150), k)
    session = [release for release in (*released, *finish(link)) if release.topic == "session/control"]
    assert [release.payload for release in session] == [b"stop%d" % k for k in range(500)]
    assert max(release.fate.held_ns for release in session) > 0
    assert min(release.fate.delay_ns for release in session) > 0


def test_reliable_topics_are_a_setting():
    assert all(fate.dropped for fate in stream(9, topic="session/x", loss={"probability": 1}, reliable=[]))
    assert not any(fate.dropped for fate in stream(9, loss={"probability": 1}, reliable=["teleop/*"]))


# --- seeds -----------------------------------------------------------------------------------------------------------


def test_same_seed_same_fates_another_seed_others():
    runs = [stream(2000, seed=seed, **HOSTILE) for seed in (3, 3, 4)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


@settings(max_examples=25, deadline=None)
@given(
    policy=st.sampled_from(["tail", "head", "random", "same_topic"]),
    polls=st.lists(st.integers(0, 60), max_size=40),
    seed=st.integers(0, 100),
)
def test_fates_do_not_depend_on_when_the_caller_asks(policy, polls, seed):
    tree = {
        **HOSTILE,
        "queue": {"limit_messages": 5, "drop": policy},
        "slots": {"min_interval_s": 0.003, "max_interval_s": 0.005},
        "topics": {"b": {"rate": {"rate_bytes_per_s": 90_000.0}}},
    }
    quiet, asked = (engine(seed=seed, **tree) for _ in range(2))
    for k in range(60):
        for topic, size in (("a", 120), ("b", 80), ("a", 30)):
            for link in (quiet, asked):
                link.submit(START + k * MS, topic, bytes(size), k)
        for part in range(polls.count(k)):
            asked.next_release_ns()
            asked.due(START + k * MS + part * MS // 50)
    finish(quiet), finish(asked)
    assert quiet.take_fates() == asked.take_fates()


MODELS = {
    "loss": {"loss": {"probability": 0.2}},
    "gilbert_elliott": {"gilbert_elliott": {"p": 0.1, "r": 0.3}},
    "jitter": {"jitter": {"scale_s": 0.005, "correlation": 0.4}},
    "duplication": {"duplication": {"probability": 0.2}},
    "corruption": {"corruption": {"probability": 0.2}},
    "reordering": {"reordering": {"probability": 0.2}},
    "apply": {"apply_probability": 0.9},
}


def outcome(fates, model):
    """What one model did to each message, where the others let it be seen."""
    originals = [fate for fate in fates if fate.copy == 0]
    seen = {
        "loss": lambda fate: fate.dropped == "loss",
        "gilbert_elliott": lambda fate: None if fate.dropped == "loss" else fate.dropped == "gilbert_elliott",
        "jitter": lambda fate: None if fate.dropped or fate.delay_ns == 0 else fate.delay_ns,
        "duplication": lambda fate: None if fate.dropped else fate.duplicated,
        "corruption": lambda fate: None if fate.dropped else fate.corrupted,
        "reordering": lambda fate: None if fate.dropped else fate.delay_ns == 0,
    }[model]
    return [seen(fate) for fate in originals]


@pytest.mark.parametrize("model", [name for name in MODELS if name != "apply"])
def test_draws_of_a_model_do_not_shift_when_others_are_switched_on(model):
    alone = outcome(stream(3000, delay_s=0.05, **MODELS[model]), model)
    others = {key: value for name, part in MODELS.items() if name != "apply" for key, value in part.items()}
    together = outcome(stream(3000, delay_s=0.05, **others), model)
    visible = [(a, b) for a, b in zip(alone, together, strict=True) if a is not None and b is not None]
    assert len(visible) > 1000
    assert all(a == b for a, b in visible)
    assert len(set(alone)) > 1


def test_topics_draw_from_streams_of_their_own():
    lonely = stream(500, topic="a", loss={"probability": 0.3})
    link = engine(loss={"probability": 0.3})
    for k in range(500):
        for topic in ("a", "b"):
            link.submit(START + k * MS, topic, bytes(100), k)
    fates = link.take_fates()
    assert [fate for fate in fates if fate.topic == "a"] == lonely
    assert [fate.dropped for fate in fates if fate.topic == "b"] != [fate.dropped for fate in lonely]


# --- change of settings ----------------------------------------------------------------------------------------------


def test_strict_order_holds_across_a_change():
    link = LinkEngine(LinkSettings.of({"forward": {"delay_s": 0.1, "order": "topic"}}), START)
    link.forward.submit(START, TOPIC, b"old", 0)
    link.reconfigure(link.settings.changed({"forward.delay_s": 0.0}), START + MS)
    link.forward.submit(START + MS, TOPIC, b"new", 1)
    assert [release.payload for release in finish(link.forward)] == [b"old", b"new"]


@pytest.mark.parametrize("rate", [1e6, "none"])
def test_what_waits_is_sent_at_the_old_rate_and_the_line_stays_busy_for_it(rate):
    link = LinkEngine(LinkSettings.of({"forward": {"rate": {"rate_bytes_per_s": 1e5}}}), START)
    for k in range(5):
        link.forward.submit(START, TOPIC, bytes(100), k)
    link.reconfigure(link.settings.changed({"forward.rate.rate_bytes_per_s": rate}), START)
    released = [*link.forward.submit(START, TOPIC, bytes(100), 5), *finish(link.forward)]
    times = {release.fate.seq: (release.fate.release_ns - START) / MS for release in released}
    assert times == {0: 1, 1: 2, 2: 3, 3: 4, 4: 5, 5: 5.1 if rate == 1e6 else 0}


def test_change_of_another_key_does_not_touch_the_queue_or_restart_models():
    tree = {"forward": {**HOSTILE, "queue": {"limit_messages": 20}}}
    runs = []
    for change in (False, True):
        link = LinkEngine(LinkSettings.of(tree), START)
        for k in range(400):
            if change and k == 200:
                link.reconfigure(link.settings.changed({"backward.delay_s": 0.3, "forward.reliable": "x"}), START)
            link.forward.submit(START + k * MS, TOPIC, bytes(150), k)
        finish(link.forward)
        runs.append(link.take_fates())
    assert runs[0] == runs[1]


def test_new_seed_restarts_the_streams():
    link = LinkEngine(LinkSettings.of({"seed": 5, "forward": {"loss": {"probability": 0.5}}}), START)
    passed = []
    for _ in range(2):
        passed.append([bool(link.forward.submit(START, TOPIC, b"", k)) for k in range(200)])
        link.reconfigure(link.settings.changed({"seed": 6}), START)
        link.reconfigure(link.settings.changed({"seed": 5}), START)
    assert passed[0] == passed[1]


def test_pattern_can_come_and_go_with_messages_waiting():
    link = LinkEngine(LinkSettings.of({"forward": {"rate": {"rate_bytes_per_s": 1e5}, "order": "topic"}}), START)
    for k in range(30):
        if k == 10:
            link.reconfigure(link.settings.changed({"forward.topics.teleop/*.delay_s": 0.01}), START + k)
        if k == 20:
            link.reconfigure(LinkSettings.of({"forward": {"order": "topic"}}), START + k)
        link.forward.submit(START + k, TOPIC, bytes(100), k)
    assert [release.fate.seq for release in finish(link.forward)] == list(range(30))


# --- conservation and figures ----------------------------------------------------------------------------------------

share = st.floats(0.0, 1.0)
IMPAIRMENTS = st.fixed_dictionaries(
    {},
    optional={
        "delay_s": st.floats(0.0, 0.05),
        "jitter": st.fixed_dictionaries(
            {
                "scale_s": st.floats(0.0, 0.02),
                "distribution": st.sampled_from(["uniform", "normal", "pareto"]),
                "correlation": st.floats(0.0, 0.95),
            }
        ),
        "loss": st.fixed_dictionaries({"probability": share, "correlation": st.floats(0, 0.9)}),
        "markov_loss": st.fixed_dictionaries({"p13": st.floats(0, 0.5), "p14": st.floats(0, 0.5)}),
        "gilbert_elliott": st.fixed_dictionaries({"p": share, "r": st.floats(0.1, 1.0), "loss_in_good": share}),
        "corruption": st.fixed_dictionaries({"probability": share, "bits": st.integers(1, 20)}),
        "duplication": st.fixed_dictionaries({"probability": share}),
        "order": st.sampled_from(["any", "topic", "link"]),
        "rate": st.fixed_dictionaries({"rate_bytes_per_s": st.none() | st.floats(1e3, 1e7)}),
        "queue": st.fixed_dictionaries(
            {
                "limit_messages": st.none() | st.integers(0, 5),
                "limit_bytes": st.none() | st.integers(0, 400),
                "drop": st.sampled_from(["tail", "head", "random", "same_topic"]),
            }
        ),
        "slots": st.fixed_dictionaries(
            {
                "min_interval_s": st.floats(1e-3, 1e-2),
                "max_messages": st.none() | st.integers(1, 3),
                "max_bytes": st.none() | st.integers(1, 300),
            }
        ),
        "outage": st.fixed_dictionaries(
            {
                "mean_up_s": st.floats(1e-3, 0.05),
                "mean_down_s": st.floats(1e-3, 0.05),
                "mode": st.sampled_from(["drop", "hold"]),
            }
        ),
        "apply_probability": share,
    },
)
ARRIVALS = st.lists(
    st.tuples(st.integers(0, 5 * MS), st.sampled_from(["a", "b", "session/control"]), st.integers(0, 300)),
    min_size=1,
    max_size=60,
)


@pytest.mark.check("takes 2.7 s")
@settings(max_examples=300, deadline=None)
@given(
    before=IMPAIRMENTS,
    after=IMPAIRMENTS,
    reordering=st.floats(0.0, 1.0),
    override=IMPAIRMENTS.filter(bool),
    arrivals=ARRIVALS,
    seed=st.integers(0, 9),
)
def test_every_message_has_one_fate_and_none_is_missing_from_the_counts(
    before, after, reordering, override, arrivals, seed
):
    def link_settings(tree):
        if tree.get("order", "any") == "any" and override.get("order", "any") == "any":
            tree = {**tree, "reordering": {"probability": reordering}}
        return LinkSettings.of({"seed": seed, "forward": {**tree, "topics": {"b": override}}})

    link = LinkEngine(link_settings(before), START)
    now, released = START, []
    for seq, (step, topic, size) in enumerate(arrivals):
        now += step
        if seq == len(arrivals) // 2:
            link.reconfigure(link_settings(after), now)
        out = link.forward.submit(now, topic, bytes(size), seq)
        assert all(release.fate.release_ns <= now for release in out)
        released += out
        stats = link.forward.stats()
        assert stats.messages_out == len(released)
        assert stats.messages_out + sum(stats.dropped.values()) + stats.in_flight == seq + 1 + stats.duplicated
    released += finish(link.forward)

    fates = link.take_fates()
    assert sorted(fate.seq for fate in fates if fate.copy == 0) == list(range(len(arrivals)))
    assert len({(fate.seq, fate.copy) for fate in fates}) == len(fates)
    assert sum(fate.duplicated for fate in fates) == sum(fate.copy for fate in fates) == stats.duplicated
    assert sorted(fate for fate in fates if not fate.dropped) == sorted(release.fate for release in released)
    for fate in fates:
        if fate.release_ns is None:
            assert fate.dropped
            assert fate.topic != "session/control"
        else:
            assert fate.release_ns >= fate.arrived_ns
            assert fate.delay_ns == fate.release_ns - fate.arrived_ns
            assert fate.delay_ns >= fate.queue_ns + fate.held_ns
    seqs = [release.fate.seq for release in released if release.topic == "session/control"]
    assert seqs == sorted(seqs)
    if before.get("order", "any") != "any" and after.get("order", "any") != "any":
        seqs = [release.fate.seq for release in released if release.topic == "a"]
        assert seqs == sorted(seqs)


def test_figures_count_everything_and_take_the_delays_anew():
    link = engine(delay_s=0.01, topics={"slow": {"delay_s": 0.03}, "lost": {"loss": {"probability": 1.0}}})
    for k, topic in enumerate(("slow", TOPIC, "lost", TOPIC)):
        link.submit(START + k * MS, topic, bytes(10), k)
    link.due(START + 12 * MS)
    stats = link.stats()
    assert (stats.messages_in, stats.messages_out, stats.bytes_in, stats.bytes_out) == (4, 1, 40, 10)
    assert stats.dropped == {
        "outage": 0,
        "loss": 1,
        "markov_loss": 0,
        "gilbert_elliott": 0,
        "loss_trace": 0,
        "queue": 0,
    }
    assert (stats.queued, stats.in_flight, stats.delay_count) == (0, 2, 1)
    link.due(START + 50 * MS)
    stats = link.stats()
    assert stats.delay_count == 2
    assert (stats.delay_mean_s, stats.delay_min_s, stats.delay_max_s) == pytest.approx(
        (0.02, 0.01, 0.03), rel=1e-12, abs=0
    )
    stats = link.stats()
    assert (stats.delay_count, stats.delay_mean_s, stats.delay_min_s, stats.delay_max_s) == (0, None, None, None)
    assert stats.messages_out == 3


# --- the ends of every setting ---------------------------------------------------------------------------------------


def _ends(schema, root, path=()):
    """Yield the dotted key of every number among the settings, with the least and the greatest value."""
    schema = root["$defs"][schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema
    for key, part in schema.get("properties", {}).items():
        kind = part.get("anyOf", [part])[0]
        if "$ref" in kind:
            yield from _ends(kind, root, (*path, key))
        elif kind.get("type") in ("number", "integer"):
            low = kind.get("minimum", kind.get("exclusiveMinimum", 0) + 1e-9)
            high = kind.get("maximum", kind.get("exclusiveMaximum", 0) - 1e-9)
            yield from ((".".join((*path, key)), value) for value in (low, high))


# what a setting needs beside it to have an effect
NEEDED = {
    "jitter": {"scale_s": 3600.0, "distribution": "pareto"},
    "slots": {"min_interval_s": 1e-3},
    "rate": {"rate_bytes_per_s": 1e4},
    "queue": {"limit_messages": 10},
    "outage": {"mean_up_s": 0.1, "mean_down_s": 0.1},
    "corruption": {"probability": 0.5},
    "reordering": {"probability": 0.5},
}
IMPAIRMENT = Impairment.model_json_schema()


@pytest.mark.parametrize(("key", "value"), list(_ends(IMPAIRMENT, IMPAIRMENT)))
def test_every_message_has_a_fate_in_range_at_every_end_of_a_setting(key, value):
    section, _, name = key.rpartition(".")
    block = {**NEEDED.get(section, {}), name: value}
    tree = {section: block} if section else block
    if section == "queue":
        tree["rate"] = NEEDED["rate"]
    if key == "slots.max_interval_s":
        tree["slots"]["min_interval_s"] = min(value, 1e-3)
    try:
        settings_now = LinkSettings.of({"forward": tree})
    except ConfigError as error:
        # what contradicts another key is refused in words
        assert "Input should" not in str(error)
        return
    link = DirectionEngine("forward", settings_now, START)
    for number in range(100):
        link.submit(START + number * MS, TOPIC, bytes(100), number)
    # what waits for longer than a session is let go by other settings
    link.due(START + 10**10)
    link.adopt(LinkSettings.of({}), link.files_of(LinkSettings.of({})), START + 10**10)
    finish(link)
    fates = link.take_fates()
    assert {fate.seq for fate in fates} == set(range(100))
    for fate in fates:
        assert all(
            0 <= time_ns < 2**63 for time_ns in (fate.delay_ns, fate.queue_ns, fate.held_ns, fate.release_ns or 0)
        )
