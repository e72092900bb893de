"""What a figure states beside its numbers comes from the recording, not from what was asked for."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, sample

from telenano.analysis import Session
from telenano.analysis.conditions import _law_status, conditions, described, laws_in_turn, title
from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.settings.scenario import Scenario
from telenano.wire import ConfigError, encode
from telenano.wire.codec import fields_of

SCENARIO = Scenario(
    name="trial", description="", duration_s=1.0, controller={"law": "wave"}, delay_node={"profile": "lte", "seed": 7}
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A session of 100 ms in which the law was switched, with a link that adds 20 and 30 ms."""
    writer = RecordingWriter.create(NODE, FileSettings(directory=tmp_path_factory.mktemp("conditions")))
    ways = {}
    for way, delay_s in (("forward", 0.02), ("backward", 0.03)):
        given = fields_of(sample("link/status", 0))[way]
        ways[way] = given | {"delay_valid": True, "delay_mean_s": delay_s, "delay_min_s": 0.0, "delay_max_s": 0.1}
    messages = []
    for n in range(10):
        law = {"law": "wave" if n < 5 else "passivity", "round_trip_valid": n > 0, "round_trip_s": 0.05}
        messages.append(("law/status", "controller@master", law))
        # the other half is not asked
        messages.append(("law/status", "controller@slave", {"law": "smith"}))
    ack = {"kind": "ack", "text": "set law = passivity", "level": "info"}
    messages += [("link/status", "delay_node@master", ways), ("session/event", "controller@master", ack)]
    for n, (topic, src, fields) in enumerate(messages):
        message = sample(topic, n, src=src, t_ns=EPOCH_NS + n * MILLISECOND_NS, **fields)
        channel = writer.channel(topic, src, src.partition("@")[2])
        writer.write(channel, message.t_ns, message.t_ns, n, encode(message))
    writer.finish()
    return Recording(writer.path)


def test_the_laws_that_ran_and_the_delay_that_was_are_stated(recording: Recording) -> None:
    found = conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    assert found["law"] == ["wave", "passivity"]
    assert found["changed"] == ["controller@master: set law = passivity"]
    assert (found["link_round_trip_ms"], found["loop_round_trip_ms"]) == (50.0, 50.0)
    assert (found["link_profile"], found["link_seed"]) == ("lte", 7)
    assert found["instrument"] == "ideal"
    assert found["parameters"]["impedance_n_s_per_m"] == 100.0
    assert title(found) == "wave then passivity, round trip of the link 50 ms, link lte"
    assert title({**found, "instrument": "real"}).endswith("link lte, instrument real")


def test_a_law_that_is_not_installed_is_named(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    needed = {"laws.absent": {"package": "of-a-stranger", "version": "1.2"}}
    monkeypatch.setattr("telenano.analysis.conditions.recorded_plugins", lambda *_: needed)
    with pytest.raises(ConfigError, match=r"law absent of of-a-stranger 1\.2"):
        conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)


def test_a_report_at_the_first_instant_of_a_session_belongs_to_it(recording: Recording) -> None:
    # The last report of the first law came 8 ms after the beginning of the recording.
    found = laws_in_turn(recording, EPOCH_NS + 8 * MILLISECOND_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    assert found == [(0.0, "wave"), (pytest.approx(0.002), "passivity")]


def test_the_loop_s_round_trip_is_rounded_to_a_microsecond() -> None:
    columns = {
        "t_ns": np.array([0, 1, 2]),
        "src": np.array(["controller@master"] * 3),
        "law": np.array(["wave"] * 3),
        "round_trip_s": np.array([0.0, 0.0012344, 0.0012348]),
        "round_trip_valid": np.array([False, True, True]),
    }
    recording: Any = SimpleNamespace(
        channels=[SimpleNamespace(channel_topic="law/status")], columns=lambda topic, names: columns
    )
    assert _law_status(recording, 0, 2) == (["wave"], 1.235)


@pytest.mark.parametrize(
    ("greatest_ms", "median_ms", "words"),
    [(10.0, 5.0, "5 ms"), (10.1, 5.0, "0 to 10.1 ms"), (30.0, 60.0, "60 ms"), (30.1, 60.0, "0 to 30.1 ms")],
)
def test_a_range_is_shown_where_it_is_wider_than_ten_milliseconds_and_half_of_the_median(
    recording: Recording, greatest_ms: float, median_ms: float, words: str
) -> None:
    found = conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    found |= {"link_round_trip_range_ms": [0.0, greatest_ms], "link_round_trip_ms": median_ms}
    assert title(found) == f"wave then passivity, round trip of the link {words}, link lte"


def test_each_law_has_the_time_from_which_it_was_in_force_and_the_first_one_that_of_the_begin(
    recording: Recording, tmp_path: Path
) -> None:
    # The session began 5 ms before the first report, and the second law reports 10 ms after that.
    turns = laws_in_turn(recording, EPOCH_NS - 5 * MILLISECOND_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    assert [law for _, law in turns] == ["wave", "passivity"]
    assert [at_s for at_s, _ in turns] == [0.0, pytest.approx(0.015, rel=1e-9)]
    writer = RecordingWriter.create(NODE, FileSettings(directory=tmp_path))
    writer.finish()
    assert laws_in_turn(Recording(writer.path), EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS) == []


@pytest.mark.parametrize(
    ("median_ms", "range_ms", "words"),
    [
        # It varies by 10 ms, and by half of its median.
        (100.0, [80.0, 129.0], "100 ms"),
        (100.0, [80.0, 131.0], "80 to 131 ms"),
        (15.0, [10.0, 19.0], "15 ms"),
        (15.0, [10.0, 21.0], "10 to 21 ms"),
        (0.0, [0.0, 9.0], "0 ms"),
        (0.0, [0.0, 11.0], "0 to 11 ms"),
        # Older summaries have no range.
        (50.0, None, "50 ms"),
    ],
)
def test_a_round_trip_is_stated_with_its_range_where_it_varies_much(
    recording: Recording, median_ms: float, range_ms: list[float] | None, words: str
) -> None:
    found = conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    made = {**found, "link_round_trip_ms": median_ms, "link_round_trip_range_ms": range_ms}
    assert title(made) == f"wave then passivity, round trip of the link {words}, link lte"


def test_what_the_loop_bridges_is_stated_where_the_link_says_nothing(recording: Recording) -> None:
    found = conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    made = {**found, "link_round_trip_ms": None, "link_round_trip_range_ms": None}
    assert title(made) == "wave then passivity, round trip of the loop 50 ms, link lte"


def test_all_conditions_are_in_the_metadata_of_a_figure(recording: Recording) -> None:
    found = conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    text = described("trial", found)
    for part in ("trial", title(found), "impedance_n_s_per_m=100.0", "changed: controller@master", "lte, seed 7"):
        assert part in text
    assert "changed: nothing" in described("trial", {**found, "changed": []})


def test_a_network_of_ones_own_is_not_called_clean(recording: Recording) -> None:
    for section, name, ending in (
        ({"forward": {"jitter": {"scale_s": 0.01}}}, "custom", ", link custom"),
        ({"profile": "lte", "forward": {"delay_s": 0.2}}, "lte, changed", ", link lte, changed"),
        ({"forward": {"delay_s": 0.2}}, "constant delay", "round trip of the link 50 ms"),
        ({}, "clean", "round trip of the link 50 ms"),
    ):
        scenario = SCENARIO.model_copy(update={"delay_node": section})
        found = conditions(recording, scenario, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
        assert found["link_profile"] == name
        assert title(found).endswith(ending)


def test_a_delay_that_was_changed_in_the_session_is_stated_with_both_ends(recording: Recording) -> None:
    found = conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    assert found["link_round_trip_range_ms"] == [50.0, 50.0]
    # as where somebody typed 200 ms one way into the page after a long session without delay
    changed = {**found, "link_round_trip_ms": 0.0, "link_round_trip_range_ms": [0.0, 400.0]}
    assert title(changed) == "wave then passivity, round trip of the link 0 to 400 ms, link lte"


def test_the_least_and_the_greatest_delay_of_a_link_are_those_of_its_reports(tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, FileSettings(directory=tmp_path))
    channel = writer.channel("link/status", "delay_node@master", "master")
    for n, delay_s in enumerate((0.0, 0.0, 0.0, 0.2000003)):
        way = fields_of(sample("link/status", 0))["forward"]
        way |= {"delay_valid": True, "delay_mean_s": delay_s, "delay_min_s": 0.0, "delay_max_s": 0.3}
        t_ns = EPOCH_NS + n * MILLISECOND_NS
        message = sample("link/status", n, src="delay_node@master", t_ns=t_ns, forward=way, backward=way)
        writer.write(channel, t_ns, t_ns, n, encode(message))
    writer.finish()
    found = conditions(Recording(writer.path), SCENARIO, EPOCH_NS, EPOCH_NS + 100 * MILLISECOND_NS)
    # To a microsecond.
    assert (found["link_round_trip_ms"], found["link_round_trip_range_ms"]) == (0.0, [0.0, 400.001])


def test_what_happened_outside_the_session_does_not_count(recording: Recording) -> None:
    found = conditions(recording, SCENARIO, EPOCH_NS, EPOCH_NS + 3 * MILLISECOND_NS)
    assert (found["law"], found["changed"], found["link_round_trip_ms"]) == (["wave"], [], None)
    # where nothing was received, the law is that of the scenario
    before = conditions(recording, SCENARIO, 0, 1)
    assert (before["law"], before["loop_round_trip_ms"]) == (["wave"], None)
    assert title(before) == "wave, link lte"


@pytest.mark.check("takes 2 s")
def test_a_session_states_its_round_trip_and_versions(recording_of: Callable[[str], Path]) -> None:
    found = Session.of(Recording(recording_of("wave"))).conditions
    # 4 ms each way, and what the loop itself takes, in whole periods
    assert 8.0 <= found["loop_round_trip_ms"] <= 12.0
    assert found["version"] != "unknown"


def test_a_warning_that_the_session_was_outside_of_what_was_shown_is_stated_once(tmp_path: Path) -> None:
    def found(name: str, *data: dict[str, object]) -> dict[str, object]:
        writer = RecordingWriter.create(NODE, FileSettings(directory=tmp_path / name))
        for n, facts in enumerate(data):
            text = {"kind": "node", "level": "warning", "text": f"warning {n}", "data": facts}
            message = sample("session/event", n, src="launcher@slave", t_ns=EPOCH_NS + (n + 1) * MILLISECOND_NS, **text)
            # it is recorded where it was sent and where it arrived
            for site in ("slave", "master"):
                channel = writer.channel("session/event", message.src, site)
                writer.write(channel, message.t_ns, message.t_ns, n, encode(message))
        writer.finish()
        return conditions(Recording(writer.path), SCENARIO, EPOCH_NS, EPOCH_NS + 3 * MILLISECOND_NS)

    (tmp_path / "warned").mkdir()
    (tmp_path / "plain").mkdir()
    facts: dict[str, object] = {"outside": "drift", "law": "wave", "drift_pm_per_s": 50.0}
    # the second is another warning, and the last is of a time after the session
    rows = found("warned", facts, {"state": "silent"}, facts, facts)["outside_of_shown"]
    assert rows == [
        {"time_s": 0.001, "law": "wave", "axis": "drift", "text": "warning 0"},
        {"time_s": 0.003, "law": "wave", "axis": "drift", "text": "warning 2"},
    ]
    assert "outside_of_shown" not in found("plain", {"state": "silent"})
