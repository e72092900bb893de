"""`telenano study network` runs the laws over what `telenano link probe` has measured."""

import json
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.networks.network_trace import DIRECTIONS, NetworkTrace, write_traces
from telenano_lab.studies.loops.network import measured_network

from telenano.testing import invoke
from telenano.wire import ConfigError

LOST = 0.1


def probe(folder: Path, one_way_s: float) -> Path:
    """Write the folder of a probe of 4 s, in which each tenth message is lost both ways."""
    folder.mkdir()
    sent_s, lost = 1e-3 * np.arange(4000), np.arange(4000) % round(1.0 / LOST) == 0
    traces = {way: NetworkTrace(way, sent_s, np.where(lost, 0.0, one_way_s), lost, 0, 0.0) for way in DIRECTIONS}
    section = write_traces(traces, folder)
    network = {way: trace.summary() for way, trace in traces.items()}
    (folder / "probe.json").write_text(json.dumps({"network": network, "replay": section}))
    return folder


def test_a_probe_becomes_its_round_trip_its_losses_and_a_link(tmp_path: Path) -> None:
    network = measured_network(probe(tmp_path / "probe", 0.02))
    assert network.round_trip_ms == pytest.approx(40.0)
    assert network.lost_share == pytest.approx(LOST)
    assert network.settings.forward.delay_trace is not None


@pytest.mark.check("runs two sessions in the contact as plain Python")
@pytest.mark.usefixtures("plain_loop")
def test_a_law_over_a_measured_network_is_judged_with_its_defaults_and_tuned(tmp_path: Path) -> None:
    folder, out = probe(tmp_path / "probe", 0.06), tmp_path / "laws"
    words = ["study", "network", str(folder), "--law", "virtual_impedance", "--out", str(out), "--json"]
    done = invoke(words)
    assert done.exit_code == 0, done.output
    assert (out / "network.html").is_file() and (out / "network.parquet").is_file()
    rows = json.loads(done.stdout)["rows"]
    assert [row["parameters"] for row in rows] == ["defaults", "tuned"]
    # the contact bears 54 ms in all with the defaults of the law
    assert rows[0]["verdict"] != "stable" and rows[1]["verdict"] == "stable"


@pytest.mark.parametrize("text", ["", "{}", '{"network": {"forward": {}}, "replay": {}}', "[1]"])
def test_a_folder_without_a_whole_probe_is_named(text: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"probe.json: is not a result of `telenano link probe`"):
        measured_network(tmp_path)
    (tmp_path / "probe.json").write_text(text)
    with pytest.raises(ConfigError, match=r"probe.json: is not a result of `telenano link probe`"):
        measured_network(tmp_path)
