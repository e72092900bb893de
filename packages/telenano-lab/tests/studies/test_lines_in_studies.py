"""A line of one's own in every study: its fitted network is taken, and a log or a table is refused with what to do."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from telenano_lab.experiments.benchmark.plan import plan_of
from telenano_lab.studies.loops.advice import Question
from telenano_lab.studies.loops.cells import Cell
from telenano_lab.studies.loops.validate import scenario_of

from telenano.settings import LinkSettings, profile_named
from telenano.testing import invoke

# What takes a network by its name; NAME stands for what a person gives.
NETWORKS = {
    "advise": ["study", "advise", "--network", "NAME", "--sample", "ordinary", "--out", "OUT"],
    "drift": ["study", "drift", "--network", "NAME", "--law", "wave", "--out", "OUT"],
    "validate": ["study", "validate", "--network", "NAME", "--law", "wave", "--out", "OUT"],
    "benchmark": ["benchmark", "--network", "NAME", "--quick", "--out", "OUT"],
    "profile": ["link", "profile", "NAME", "--show"],
    "picture": ["link", "picture", "NAME", "--out", "OUT"],
    "udp": ["link", "udp", "127.0.0.1:47123", "127.0.0.1:47124", "--profile", "NAME"],
    "up": ["up", "--scenario", "fig12", "--set", "delay_node.profile=NAME", "--out", "OUT"],
}
# What takes round trips as numbers.
NUMBERS = {
    "stability": ["study", "stability", "--law", "wave", "--environment", "wall", "--delay", "NAME", "--out", "OUT"],
    "transparency": ["study", "transparency", "--delay", "NAME", "--out", "OUT"],
    "push": ["study", "push", "--delay", "NAME", "--out", "OUT"],
}
# What takes a folder of `link probe`, and what has delays of its own alone.
OTHERS = {"network": ["study", "network", "NAME", "--out", "OUT"]}
OWN = {"gallery", "promises"}


def written(folder: Path, kind: str) -> Path:
    draw = np.random.default_rng(1)
    delays = (20.0 + draw.gamma(2.0, 2.0, 400)).tolist()
    if kind == "a ping log":
        lines = [f"[{1.7e9 + 0.1 * n:.6f}] 64 bytes from a: icmp_seq={n + 1} ttl=57 time={ms:.1f} ms"
                 for n, ms in enumerate(delays)]  # fmt: skip
        text, name = "\n".join(["PING a (1)", *lines, ""]), "ping.txt"
    elif kind == "a table of delays":
        lines = [f"{100 * n},{ms:.3f}" for n, ms in enumerate(delays)]
        text, name = "\n".join(["sent_ms,delay_ms", *lines, ""]), "line.csv"
    else:
        way = {"jitter": {"distribution": "table", "scale_s": 1.0, "quantiles": "0.0:0.02,1.0:0.04"}, "order": "link"}
        statistics = {"mean_ms": 30.0, "percentiles_ms": {50: 30.0}}
        text, name = yaml.safe_dump({"about": "a line", "statistics": {"forward": statistics, "backward": statistics},
                                     "link": {"forward": way, "backward": way}}), "my_line.yaml"  # fmt: skip
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def _run(command: list[str], name: Path, folder: Path) -> str:
    words = [word.replace("NAME", str(name)).replace("OUT", str(folder / "out")) for word in command]
    done = invoke(words)
    assert done.exit_code != 0, done.output
    assert not (folder / "out").exists()
    return re.sub(r"\s+", " ", done.output)


@pytest.mark.parametrize("kind", ["a ping log", "a table of delays", "a fitted profile"])
@pytest.mark.parametrize("study", [*NETWORKS, *NUMBERS, *OTHERS])
def test_a_file_of_a_line_is_refused_with_the_way_it_goes_in(study: str, kind: str, tmp_path: Path) -> None:
    path = written(tmp_path, kind)
    said = _run({**NETWORKS, **NUMBERS, **OTHERS}[study], path, tmp_path)
    if study not in NETWORKS:
        assert "telenano link fit" in said and "--network" in said, said
    elif kind == "a fitted profile":
        assert f"TELENANO_NETWORKS={tmp_path} and name it as my_line" in said, said
    else:
        assert f"telenano link fit {path}" in said and "TELENANO_NETWORKS" in said, said


def test_each_study_is_in_the_table() -> None:
    listed = invoke(["study", "--help"]).output.partition("Commands:")[2]
    names = set(re.findall(r"^  (\w+) ", listed, re.MULTILINE))
    assert names == {*NETWORKS, *NUMBERS, *OTHERS, *OWN} - {"benchmark", "profile", "picture", "udp", "up"}


def test_a_fitted_network_of_a_folder_goes_into_each_study_that_takes_one(networks_folder: Path) -> None:
    written(networks_folder, "a fitted profile")
    # the parts that each of the commands begins with
    assert profile_named("my_line").round_trip_ms == 60.0
    assert LinkSettings.of({"profile": "my_line"}).forward.order == "link"
    assert Question.model_validate({"network": "my_line", "sample": "ordinary"}).round_trip_ms == 60.0
    assert "my_line" in str(
        scenario_of(
            Cell(law="wave", environment="wall", stiffness_n_per_m=200.0, round_trip_ms=60.0, network="my_line")
        )
    )
    assert plan_of(["wave"], quick=True, networks=["my_line"]).networks == ("my_line",)
    assert "a line" in invoke(["link", "profile", "my_line", "--show"]).output
