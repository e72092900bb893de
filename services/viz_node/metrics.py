"""The page /metrics for monitoring systems: the newest reports of all nodes, in the text format 0.0.4 of Prometheus."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from telenano.timing.loop_age import Part
from telenano.wire.messages import PROCESS_FIGURES
from telenano.wire.nodes import counts_for_process

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
# Time after which the text is made again [ns].
_PERIOD_NS = 1_000_000_000
_STATES = ("starting", "ready", "running", "safe", "stopping", "ended")


class Metric(NamedTuple):
    """A metric made from node/health: key in the message, name of the metric, its kind, and its description."""

    key: str
    name: str
    kind: str
    about: str


NODE_METRICS = (
    Metric("uptime_s", "telenano_uptime_seconds", "gauge", "Time since the node started."),
    Metric("rate_hz", "telenano_rate_hertz", "gauge", "Steps of the node in a second."),
    Metric("lateness_p99_s", "telenano_lateness_p99_seconds", "gauge", "99 % lateness since the last report."),
    Metric("overruns", "telenano_overruns_total", "counter", "Deadlines missed by a period or more."),
    Metric("lost", "telenano_lost_messages_total", "counter", "Messages of its inputs that never came."),
    Metric("rejected", "telenano_rejected_messages_total", "counter", "Frames and connections that were refused."),
    Metric("cpu_percent", "telenano_processor_percent", "gauge", "Processor time, in percent of one."),
    Metric("memory_bytes", "telenano_resident_memory_bytes", "gauge", "Resident memory."),
)


_MATES = "shares_with"


def metrics_text(nodes: Mapping[str, Mapping[str, Any]], now_ns: int, age: Sequence[Part] = ()) -> str:
    """Return the text, with one sample for each node and metric.

    A figure of a process is given for one of its nodes only, so that a sum over nodes counts each process once.

    Args:
        nodes: The newest report by node, such as `afm_node@slave`, with `beat`, the time of sending [ns], and `state`.
        now_ns: The time on the clock with which the nodes stamp their messages [ns].
        age: The parts of the loop's age.
    """
    lines: list[str] = []
    for metric in NODE_METRICS:
        values = [
            (src, facts[metric.key])
            for src, facts in nodes.items()
            if metric.key in facts and (metric.key not in PROCESS_FIGURES or counts_for_process(src, facts.get(_MATES)))
        ]
        lines += _family(metric.name, metric.kind, metric.about, ((f'node="{_escaped(src)}"', v) for src, v in values))
    ages = ((f'node="{_escaped(src)}"', (now_ns - facts["beat"]) * 1e-9) for src, facts in nodes.items())
    lines += _family("telenano_report_age_seconds", "gauge", "Time since the newest report of the node.", ages)
    states = (
        (f'node="{_escaped(src)}",state="{state}"', float(facts.get("state") == state))
        for src, facts in nodes.items()
        for state in _STATES
    )
    parts = (
        (f'part="{part.name}",quantile="{share}"', value)
        for part in age
        for share, value in (("0.5", part.p50_s), ("0.99", part.p99_s))
    )
    about = "Age of what the hand feels, by its parts, while a page is open."
    lines += _family("telenano_loop_age_seconds", "summary", about, parts)
    lines += _family("telenano_state", "gauge", "1 at what the node is at, 0 at the others.", states)
    return "\n".join(lines) + "\n"


def _family(name: str, kind: str, about: str, samples: Iterable[tuple[str, float]]) -> list[str]:
    head = [f"# HELP {name} {about}", f"# TYPE {name} {kind}"]
    return head + [f"{name}{{{labels}}} {float(value):.9g}" for labels, value in samples]


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


class MetricsText:
    """Caches the text for a second, because making it for every request would take time from the pages."""

    def __init__(self) -> None:
        self._text, self._made_ns = "", -_PERIOD_NS

    def at(self, now_ns: int, make: Callable[[], str]) -> str:
        """Return the text at a time [ns]; it is made again if the last one is older than a second."""
        if not 0 <= now_ns - self._made_ns < _PERIOD_NS:
            self._text, self._made_ns = make(), now_ns
        return self._text
