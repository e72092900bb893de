"""What a live apparatus sets and expects of a rig, and what it reads from the recording of a trial."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiment_bench import plan_of

from proto.errors import RecordingError
from recording.channel_filter import Selection
from recording.rewrite import filter_recording
from services.controller.config import ControllerConfig, changed_config
from services.delay_node.config import changed, flattened, parse_settings
from studies.experiments.apparatus.live import Live, constant_delays_ns, kept_keys, wanted_of
from studies.experiments.desk import Desk
from studies.experiments.disturbances import disturbances
from studies.experiments.recorded_trial import RecordedTrial


def documents(folder: Path, **changes: Any) -> list[dict[str, Any]]:
    plan = plan_of(folder, **changes)
    return [plan.document(trial.settings, "") for trial in plan.trials("P01")]


def test_whatever_came_before_a_trial_leaves_nothing_behind(tmp_path: Path) -> None:
    levels = {
        "plain": {"delay_node.profile": "clean"},
        "bursts": {"delay_node.forward.loss.probability": 0.3, "delay_node.forward.jitter.scale_s": 0.01},
        "far": {"delay_node.profile": "satellite"},
        "damped": {"controller.wave.damping_n_s_per_m": 77.0, "controller.law": "wave"},
    }
    link, law = parse_settings({}), ControllerConfig()
    for document in documents(tmp_path, factors={"x": {"levels": levels}}, repetitions=3):
        wanted = wanted_of(document, 7)
        link, law = changed(link, wanted.link), changed_config(law, wanted.law)
        alone = {"seed": 7, **document["delay_node"]}
        assert flattened(link) == flattened(parse_settings(alone))
        assert law.model_dump() == ControllerConfig.model_validate({**document["controller"]}).model_dump()


def test_only_what_a_running_rig_does_not_take_needs_a_new_one(tmp_path: Path) -> None:
    taken = documents(
        tmp_path, factors={"law": ["wave", "passivity"], "round_trip_ms": [0, 80], "network": ["lan", "4g"]}
    )
    assert len({str(kept_keys(document)) for document in taken}) == 1
    kept = documents(tmp_path, factors={"afm_node.rest_distance_m": [1e-8, 2e-8], "law": ["wave", "passivity"]})
    assert len({str(kept_keys(document)) for document in kept}) == 2


@pytest.mark.parametrize(
    ("link", "delays"),
    [
        ({"profile": "clean", "seed": 1}, {"forward": 0, "backward": 0}),
        ({"forward.delay_s": 0.0207, "backward.delay_s": 0.04}, {"forward": 20_000_000, "backward": 40_000_000}),
        ({"forward.delay_s": 0.02, "forward.loss.probability": 0.1}, {"forward": 20_000_000, "backward": 0}),
        ({"forward.jitter.scale_s": 0.01, "backward.delay_s": 0.01}, {"backward": 10_000_000}),
        ({"forward.rate.rate_bytes_per_s": 1e4, "backward.order": "topic"}, {}),
    ],
)
def test_a_delay_is_expected_where_nothing_random_makes_it(link: dict[str, Any], delays: dict[str, int]) -> None:
    assert constant_delays_ns(link) == delays


def test_a_recording_gives_the_tables_and_the_evidence_of_a_trial(recording_of: Callable[[str], Path]) -> None:
    trial = RecordedTrial(recording_of("fig12_wave"))
    data = trial.data(2.0)
    for table, column in (
        (data.afm, "tip_force_n.2"),
        (data.haptic, "operator_force_n.2"),
        (data.status, "port_energy_j"),
    ):
        times_s = table["time_s"]
        assert times_s[0] >= 0.0 and times_s[-1] <= 2.0 and np.all(np.diff(times_s) >= 0.0)
        assert table.units["time_s"] == "s" and table[column].dtype == np.float64
    assert set(data.status["src"]) == {"controller@master"}
    assert -data.haptic["operator_force_n.2"].min() == pytest.approx(1.0, rel=1e-6)
    evidence = trial.evidence(2.0)
    assert len(evidence.forward.arrived_s) > 1000
    assert not evidence.estops and not evidence.restarted and not evidence.missing
    assert disturbances(evidence, 10.0) == []


def test_a_recording_without_a_programme_is_no_trial(tmp_path: Path, recording_of: Callable[[str], Path]) -> None:
    out = tmp_path / "without.mcap"
    filter_recording(recording_of("fig12_wave"), out, Selection.of(["node/*"]))
    with pytest.raises(RecordingError, match="no programme of an operator ran in it"):
        RecordedTrial(out)


class Moved(Live):
    """A rig whose tip is where the test says, at each look."""

    def __init__(self, plan: Any, folder: Path, bases_nm: list[float]) -> None:
        super().__init__(plan, folder, Desk(plan), lambda text: self.told.append(text))
        self.bases_nm, self.told, self.started = bases_nm, [], 0
        self._running = False

    def _rig_of(self, trial: Any, document: Any) -> Any:
        if not self._running:
            self.started, self._running, self._first_base_m = self.started + 1, True, None
        return "rig"

    def _ready(self) -> None:
        """Nothing is in emergency stop."""

    def _change(self, wanted: Any) -> None:
        """The condition is set."""

    def _states(self) -> dict[str, Any]:
        return {"afm/state": SimpleNamespace(base_position_m=(0.0, 0.0, -1e-9 * self.bases_nm.pop(0)))}

    def close(self) -> None:
        self._running = False


@pytest.mark.parametrize(
    ("bases_nm", "started", "is_person"),
    [
        ([0.1, 0.3, -0.4, 1.9], 1, False),
        # a stall had moved the tip by 48.6 nm in a run of 72 trials, and those after it missed the sample
        ([-0.2, -48.8, 0.1, 0.2, 0.0], 2, False),
        ([0.0, 65.8, -65.8, 65.8, 0.0], 1, True),
    ],
)
def test_a_coupling_that_has_moved_costs_a_new_rig_and_no_trial(
    tmp_path: Path, bases_nm: list[float], started: int, is_person: bool
) -> None:
    plan = plan_of(tmp_path, operator={"kind": "person" if is_person else "simulated"})
    live = Moved(plan, tmp_path, list(bases_nm))
    trial = plan.trials("P01")[0]
    document = plan.document(trial.settings, "")
    wanted = wanted_of(document, 1)
    assert bool(wanted.operator) != is_person
    for _ in range(4):
        live._rig_in(trial, document, wanted)
        assert is_person or abs(live._base_m) <= 2e-9
    assert live.started == started
    assert len(live.told) == started - 1
