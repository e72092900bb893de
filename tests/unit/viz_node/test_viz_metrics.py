"""What a monitoring system reads at /metrics: one sample for each node and figure, in the text of Prometheus."""

import re
from pathlib import Path

from services.viz_node.metrics import NODE_METRICS, metrics_text
from telenano.timing.loop_age import Part

SAMPLE = re.compile(r'^([a-z_0-9]+)\{((?:[a-z]+="(?:[^"\\\n]|\\.)*",?)+)\} (-?[0-9.e+-]+|nan|inf)$')
NODES = {
    "afm_node@slave": {"state": "running", "uptime_s": 60.0, "rate_hz": 999.7, "overruns": 3, "lost": 0, "beat": 4_000},
    "haptic_node@master": {"state": "safe", "memory_bytes": 5 << 30, "beat": 2_000_004_000},
}


DOCUMENT = Path(__file__).parents[3] / "docs" / "operating.md"


def samples(text: str) -> dict[tuple[str, str], float]:
    found = {}
    for line in text.splitlines():
        if not line.startswith("# "):
            match = SAMPLE.match(line)
            assert match is not None, line
            found[match[1], match[2]] = float(match[3])
    return found


def test_every_figure_of_a_report_is_a_sample() -> None:
    found = samples(metrics_text(NODES, 3_000_004_000))
    assert found["telenano_rate_hertz", 'node="afm_node@slave"'] == 999.7
    assert found["telenano_overruns_total", 'node="afm_node@slave"'] == 3
    assert found["telenano_resident_memory_bytes", 'node="haptic_node@master"'] == 5 << 30
    assert found["telenano_report_age_seconds", 'node="afm_node@slave"'] == 3.0
    assert found["telenano_report_age_seconds", 'node="haptic_node@master"'] == 1.0
    assert found["telenano_state", 'node="afm_node@slave",state="running"'] == 1.0
    assert found["telenano_state", 'node="afm_node@slave",state="safe"'] == 0.0
    # what a report lacks has no sample
    assert ("telenano_rate_hertz", 'node="haptic_node@master"') not in found


def test_each_family_is_described_once_and_a_name_cannot_break_a_line() -> None:
    text = metrics_text({'a"\n\\b': {"state": "ready", "rate_hz": 1.0, "beat": 0}}, 1)
    heads = re.findall(r"^# TYPE (\S+) (gauge|counter|summary)$", text, re.MULTILINE)
    assert [name for name, _ in heads[: len(NODE_METRICS)]] == [metric.name for metric in NODE_METRICS]
    assert len(heads) == len({name for name, _ in heads}) == text.count("# HELP ")
    assert all(name.endswith("_total") == (kind == "counter") for name, kind in heads)
    assert ("telenano_rate_hertz", 'node="a\\"\\n\\\\b"') in samples(text)
    assert samples(metrics_text({}, 0)) == {}


def test_the_document_names_the_figures_that_there_are() -> None:
    named = set(re.findall(r"telenano_[a-z0-9_]+", DOCUMENT.read_text()))
    given = {name for name, _ in samples(metrics_text(NODES, 0, [Part("whole", 3e-3, 4e-3)]))} | {
        metric.name for metric in NODE_METRICS
    }
    assert named == given
