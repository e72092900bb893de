"""`summary.json` has the keys of its model: each has a row in the documents, and one that is new is noticed."""

import json
import random
import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, get_args

import pytest
from forged_files import copied
from made_sessions import FORCE_SCALE, TIP, Made, hand_force_n
from pydantic import Field, ValidationError
from soft_session import record_soft_session

from telenano.analysis import Session, session_judge, summary_of
from telenano.analysis import summary as summary_module
from telenano.analysis.holds import Hold
from telenano.analysis.report import write_report
from telenano.analysis.summary import OfTip, Package, Summary, rows_of, summary_schema
from telenano.analysis.verdict import Kind
from telenano.recording.channel_filter import ALL
from telenano.recording.multi_file import RecordingSource, open_recordings
from telenano.recording.rewrite import filter_recording

pytestmark = pytest.mark.check("makes and judges twenty sessions")

ROOT = Path(__file__).resolve().parents[3]
# a session in its whole length, and what may happen to one
MADE: dict[str, Made] = {
    "longer": Made(longer_s=(5.0, 0.03)),
    "stable": Made(),
    "of_two_clocks": Made(ahead_s=0.3, drift=1e-5),
    "of_two_readings": Made(told_s=0.02),
    "set": Made(set_s=2.0),
    "warned": Made(incidents=((2.0, "faster than what wave was shown to hold"),)),
    "of_a_full_line": Made(full_s=0.05),
    "of_a_blocked_line": Made(blocked_s=(1.2, 3.3)),
    "cut_off": Made(end_s=3.0),
    "without_answers": Made(answers=0.0),
    "without_tip": Made(without=lambda topic, time_s: topic in ("afm/state", "haptic/command")),
    "without_status": Made(without=lambda topic, time_s: topic in ("law/status", "link/status", "clock/pong")),
    "with_a_gap": Made(without=lambda topic, time_s: topic == "afm/state" and time_s > 3.0),
    "guarded": Made(
        mode=lambda time_s: "retracted" if time_s > 3.5 else "follow",
        events=((3.5, {"mode": "retracting", "reason": "force_limit"}),),
    ),
    "killed": Made(
        without=lambda topic, time_s: topic == "afm/state" and time_s > 2.0, incidents=((2.0, f"{TIP} was killed"),)
    ),
}


def summarised(recording: RecordingSource) -> dict[str, Any]:
    session = Session.of(recording)
    return summary_of(session, recording)


@pytest.fixture(scope="module")
def summaries(
    recording_of: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, dict[str, Any]]:
    """Summaries of sessions under two laws, of one of them in two parts, and of sessions that are made up."""
    files = {law: [recording_of(law)] for law in ("virtual_impedance", "wave")}
    parts = [tmp_path_factory.mktemp("parts") / name for name in ("session.mcap", "session_1.mcap")]
    filter_recording(files["wave"][0], parts[0], ALL, end_s=1.2)
    filter_recording(files["wave"][0], parts[1], ALL, start_s=1.5)
    files["in_parts"] = parts
    for name, made in MADE.items():
        files[name] = [made.write(tmp_path_factory.mktemp(name))]
    files["soft"] = [record_soft_session(tmp_path_factory.mktemp("soft"))]
    odd = tmp_path_factory.mktemp("odd") / "session.mcap"
    files["odd"] = [copied(files["stable"][0], odd, lambda place, log_ns: 0 if place == 9 else log_ns)]
    return {name: summarised(open_recordings(paths)) for name, paths in files.items()}


def keys_of(value: Any, stem: str = "") -> Iterator[str]:
    """Yield the dotted names of all keys, as the page writes them."""
    for item in value if isinstance(value, list) else ():
        yield from keys_of(item, f"{stem}[]")
    for key, inner in value.items() if isinstance(value, dict) else ():
        name = f"{stem}.{key}" if stem else key
        yield name
        # the keys of maps are names of channels, parameters and packages
        if name not in ("parameters", "plugins", "rate_hz", "completeness", "seq_gaps", "loop_age_parts_ms"):
            yield from keys_of(inner, name)


def test_every_summary_has_the_keys_of_the_page_and_each_of_them_is_met(summaries: dict[str, dict[str, Any]]) -> None:
    rows = re.findall(r"^- `([^`]+)` \(", (ROOT / "docs" / "summary.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(rows) == len(set(rows)) > 50
    met = {key for summary in summaries.values() for key in keys_of(summary)}
    packages = {f"plugins.<name>.{key}" for key in Package.model_fields}
    # In a session without noise the hand's position still settles, so that its mean over a window has no interval.
    assert met | packages | {"intervals.contact_x_cm"} == set(rows)


@pytest.mark.check("takes 1.1 s")
def test_every_summary_is_what_the_model_and_the_file_hold(
    summaries: dict[str, dict[str, Any]], recording_of: Callable[[str], Path], tmp_path: Path
) -> None:
    for name, summary in summaries.items():
        text = json.dumps(summary)
        again = Summary.model_validate_json(text).model_dump(exclude_unset=True)
        assert json.dumps(again) == text, name
    assert write_report(recording_of("wave"), tmp_path) == summaries["wave"]
    assert (tmp_path / "summary.json").read_text() == json.dumps(summaries["wave"], indent=2) + "\n"


@pytest.mark.parametrize("law", ["virtual_impedance", "wave"])
def test_the_parts_of_the_age_of_the_loop_add_up_to_it_and_the_largest_is_named(
    summaries: dict[str, dict[str, Any]], law: str
) -> None:
    parts = dict(summaries[law]["loop_age_parts_ms"])
    whole, age = parts.pop("whole"), summaries[law]["loop_age_ms"]
    for place, name in enumerate(("p50", "p99")):
        assert sum(part[place] for part in parts.values()) == pytest.approx(whole[place], rel=0.05)
        assert whole[place] == pytest.approx(age[name], rel=0.05)
    # 4 ms each way on purpose
    assert parts["link there, on purpose"] == parts["link back, on purpose"] == [4.0, 4.0]
    largest = max(parts, key=lambda name: parts[name][0])
    said = summaries[law]["loop_age_largest"]
    assert said == f"{largest}: {parts[largest][0]:.3g} of {whole[0]:.3g} ms"


def test_a_loop_that_cannot_be_followed_has_no_parts(summaries: dict[str, dict[str, Any]]) -> None:
    for name in ("stable", "without_answers", "without_tip"):
        assert not {"loop_age_parts_ms", "loop_age_largest"} & set(summaries[name])


class Further(Summary):
    """A summary with a figure more of what the tip did, which is declared here alone."""

    pressed_share: Annotated[float | None, OfTip(("in_contact", "mode"), lambda touches, _: float(touches.mean()))] = (
        Field(default=None, description="Share of the samples in which the tip touches, 0..1")
    )


def test_a_figure_of_the_tip_is_declared_in_one_place(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.setattr(summary_module, "Summary", Further)
    monkeypatch.setattr(session_judge, "Summary", Further)
    made = {share: Made(in_contact=lambda time_s, share=share: time_s < 8.0 * share) for share in (0.0, 0.25)}
    made[None] = MADE["without_tip"]
    for share, session in made.items():
        path = session.write(tmp_path_factory.mktemp("figure"))
        said = summarised(open_recordings([path]))["pressed_share"]
        assert said == (share if share is None else pytest.approx(share, rel=0.0, abs=1e-3))


def test_the_sessions_show_what_a_summary_can_say(summaries: dict[str, dict[str, Any]]) -> None:
    said = {summary["verdict"] for summary in summaries.values()}
    assert said >= {"stable", "no_data", "guarded"}
    assert summaries["of_two_clocks"]["clocks"]["applied"]
    assert summaries["of_two_readings"]["clocks"]["otherwise"] is not None
    assert summaries["without_status"]["clocks"] is None
    assert summaries["without_tip"]["greatest_pull_nn"] is None
    assert summaries["without_answers"]["loop_age_ms"] is None
    assert summaries["set"]["changed"]
    assert not summaries["cut_off"]["recording"]["complete"]
    figures = {"queue_max_ms": 50.0, "capacity_mbit": 1.0, "datagrams_per_s": 500.0, "lost_share": 0.1}
    figures |= {"queue_max_low_ms": 40.0, "queue_max_high_ms": 60.0}
    # Nothing bounds the capacity from above.
    figures |= {"capacity_low_mbit": 0.9, "capacity_high_mbit": None}
    assert summaries["of_a_full_line"]["lines"] == [
        {"direction": "forward", "full_share": 0.0, "blocked_s": [], **figures},
        {"direction": "backward", "full_share": 1.0, "blocked_s": [], **figures},
    ]
    (line,) = summaries["of_a_blocked_line"]["lines"]
    assert line["direction"] == "backward"
    # The last report of the block is the one at 3 s.
    assert [tuple(span) for span in line["blocked_s"]] == [pytest.approx((1.2, 3.0), abs=0.01)]
    assert "lines" not in summaries["wave"]
    assert len(summaries["in_parts"]["recording"]["parts"]) == 2
    assert "parts" not in summaries["wave"]["recording"]


@pytest.fixture(scope="module")
def stable(tmp_path_factory: pytest.TempPathFactory) -> tuple[Session, RecordingSource]:
    recording = open_recordings([MADE["stable"].write(tmp_path_factory.mktemp("session"))])
    return Session.of(recording), recording


@pytest.mark.check("takes 0.6 s")
def test_the_traffic_of_a_session_is_what_was_sent_in_it(
    stable: tuple[Session, RecordingSource],
) -> None:
    session, recording = stable
    sent = Counter(
        one.channel_topic for one in recording.messages() if session.start_ns <= one.publish_ns < session.end_ns
    )
    summary = summary_of(session, recording)
    assert summary["rate_hz"] == {name: round(sent[name] / session.duration_s, 3) for name in sorted(sent)}
    share = round(sent["haptic/state"] / (1000.0 * session.duration_s), 5)
    assert summary["completeness"]["haptic/state"] == share
    assert summary["overruns"] == 0


@pytest.mark.parametrize("kind", get_args(Kind))
def test_every_verdict_is_one_that_a_summary_may_have(
    stable: tuple[Session, RecordingSource], monkeypatch: pytest.MonkeyPatch, kind: Kind
) -> None:
    session, recording = stable
    hold = Hold(0.5, 1.5, 1.0, kind, None if kind == "no_data" else -1.0, 0.0, 0.0, "in words")
    monkeypatch.setattr(session_judge, "judge_holds", lambda *given: [hold])
    summary = summary_of(session, recording)
    assert (summary["verdict"], summary["reason"], summary["stable"]) == (
        kind,
        "in words",
        None if kind in ("cannot_say", "no_data") else kind == "stable",
    )
    assert summary["holds"] == [{**hold._asdict(), "facts": []}]


def new_condition(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(session.conditions, "humidity_percent", 40.0)


def new_fact_of_the_recording(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    facts = session_judge.recording_facts
    monkeypatch.setattr(session_judge, "recording_facts", lambda *given: {**facts(*given), "disk": "full"})


def new_fact_of_the_clocks(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"offset_s": 0.0, "uncertainty_s": 0.0, "drift_ppm": 0.0, "applied": False, "reason": "", "otherwise": None}
    monkeypatch.setattr(session_judge, "_clocks", lambda *given: {**found, "source": "link/status"})


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (new_condition, "humidity_percent"),
        (new_fact_of_the_recording, "recording.disk"),
        (new_fact_of_the_clocks, "clocks.source"),
    ],
)
def test_a_key_without_a_row_is_refused_by_name(
    stable: tuple[Session, RecordingSource],
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[Session, pytest.MonkeyPatch], None],
    name: str,
) -> None:
    session, recording = stable
    change(session, monkeypatch)
    with pytest.raises(ValidationError, match=re.escape(name)):
        summary_of(session, recording)


def test_a_key_that_is_left_out_is_named(
    stable: tuple[Session, RecordingSource], monkeypatch: pytest.MonkeyPatch
) -> None:
    session, recording = stable
    monkeypatch.delitem(session.conditions, "link_seed")
    with pytest.raises(ValidationError, match="link_seed"):
        summary_of(session, recording)


def test_every_key_has_a_meaning_and_a_unit_where_its_name_has_one() -> None:
    units = {"_per_s": "1/s", "_hz": "1/s", "_s": "s", "_ms": "ms", "_n": "N", "_nn": "nN", "_cm": "cm", "_ppm": "ppm"}
    for name, kind, meaning in rows_of(summary_schema()):
        assert len(meaning) >= 10, name
        assert "|" not in meaning, name
        unit = next((unit for ending, unit in units.items() if name.endswith(ending)), None)
        assert unit is None or kind.startswith("object") or f"[{unit}]" in meaning, name


def noisy(seed: int, deviation_n: float) -> Made:
    """Return a session whose tip feels the hand's force of 20 ms ago, and noise of which a part lasts for 5 ms."""
    dice, kept = random.Random(seed), [0.0]

    def tip_n(time_s: float) -> float:
        kept[0] = 0.3 * kept[0] + 0.7 * dice.gauss(0.0, deviation_n)
        return hand_force_n(time_s - 0.02) + kept[0]

    return Made(tip_n=tip_n)


@pytest.mark.parametrize(("recordings", "least"), [(12, 0.5), pytest.param(200, 0.9, marks=pytest.mark.endurance)])
def test_intervals_of_a_recording_cover_what_its_noise_hides(recordings: int, least: float, tmp_path: Path) -> None:
    found = []
    for seed in range(recordings):
        (tmp_path / f"{seed}").mkdir()
        recording = open_recordings([noisy(seed, 0.05).write(tmp_path / f"{seed}")])
        found.append(summarised(recording))
        # each is 2 MB
        (tmp_path / f"{seed}" / "session.mcap").unlink()
    for name, true in (("hold_ratio", 1.0), ("release_force_nn", 0.0)):
        known = [(summary, interval) for summary in found if (interval := summary["intervals"].get(name))]
        # 61 samples whose neighbours are correlated do not always say how well their mean is known
        assert len(known) >= 0.6 * recordings, name
        assert sum(low <= true <= high for _, (low, high) in known) >= least * len(known), name
        for summary, (low, high) in known:
            # it is the interval of the figure that the summary has, and not wider than the noise makes it
            assert 0.5 * (low + high) == pytest.approx(summary[name], abs=1e-6)
        scale = 1.0 if name == "hold_ratio" else 1e9 / FORCE_SCALE
        widths = [(high - low) / scale for _, (low, high) in known]
        assert min(widths) > 0.0
        # a window that may be a part of a longer wave has a wide one
        assert sum(width < 0.1 for width in widths) >= 0.9 * len(known), name
