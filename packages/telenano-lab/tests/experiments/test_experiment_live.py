"""What a live apparatus sets and expects of a rig, and what it reads from the recording of a trial."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiment_bench import plan_of
from telenano_lab.experiments import tasks
from telenano_lab.experiments.apparatus.base import Course, Take
from telenano_lab.experiments.apparatus.live import Live
from telenano_lab.experiments.apparatus.wanted import WantedSettings, constant_delays_ns, kept_keys, wanted_of
from telenano_lab.experiments.desk import Desk
from telenano_lab.experiments.disturbances import disturbances
from telenano_lab.experiments.recorded_trial import RecordedTrial

from telenano.recording import Selection, filter_recording
from telenano.sections import ControllerConfig, changed_config
from telenano.settings import LinkSettings
from telenano.wire import RecordingError, RigError


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
    link, law = LinkSettings.of({}), ControllerConfig()
    for document in documents(tmp_path, factors={"x": {"levels": levels}}, repetitions=3):
        wanted = wanted_of(document, 7)
        link, law = link.changed(wanted.link), changed_config(law, wanted.law)
        alone = {"seed": 7, **document["delay_node"]}
        assert link.flattened() == LinkSettings.of(alone).flattened()
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
    trial = RecordedTrial(recording_of("wave"))
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
    filter_recording(recording_of("wave"), out, Selection.of(["node/*"]))
    with pytest.raises(RecordingError, match="no operator's force profile ran in it"):
        RecordedTrial(out)


class Recorded(Live):
    """A rig whose trial is recorded already."""

    def take(self, course: Course) -> Take:
        return self._judged(course, self._folder / "trial.mcap", {}, [])


@pytest.mark.parametrize("task", [task.name for task in tasks.OWN_TASKS])
def test_a_trial_whose_recording_has_no_state_of_the_tip_is_disturbed_and_not_judged(
    tmp_path: Path, recording_of: Callable[[str], Path], task: str
) -> None:
    topics = ["haptic/state", "link/*", "law/status", "session/*"]
    filter_recording(recording_of("wave"), tmp_path / "trial.mcap", Selection.of(topics))
    plan = plan_of(tmp_path, tasks=[task], known=tasks.TASKS)
    outcome = Recorded(plan, tmp_path, Desk(plan)).run(plan.trials("P01")[0], 0)
    assert (outcome.status, outcome.measures) == ("disturbed", {})
    assert "its recording has no state of the tip" in outcome.disturbance


class Moved(Live):
    """A rig whose tip is as far from the hand's place as the test says, at each look; it may refuse to be coupled."""

    def __init__(self, plan: Any, folder: Path, offs_nm: list[float], refusals: int = 0) -> None:
        super().__init__(plan, folder, Desk(plan), lambda text: self.told.append(text))
        self.offs_nm, self.told, self.started, self.coupled, self.refusals = offs_nm, [], 0, 0, refusals
        self.conditions: list[float] = []
        self._running = False

    def _rig_of(self, trial: Any, document: Any) -> Any:
        if not self._running:
            self.started, self._running = self.started + 1, True
        return "rig"

    def _ready(self) -> None:
        """Nothing is in emergency stop."""

    def _rest(self, wanted: WantedSettings) -> None:
        """The hand is at rest."""

    def _states(self) -> dict[str, Any]:
        # the hand is at 3 mm, which the scale of the law makes 3 nm
        self.off_nm = self.offs_nm.pop(0)
        tip = SimpleNamespace(base_position_m=(0.0, 0.0, -1e-9 * (3.0 + self.off_nm)))
        return {"afm/state": tip, "haptic/state": SimpleNamespace(position_m=(0.0, 0.0, -3e-3))}

    def _couple(self) -> None:
        self.coupled += 1
        if self.refusals:
            self.refusals -= 1
            raise RigError("the hand presses")

    def _prepare_sample(self, document: Any) -> None:
        """There is nothing across."""

    def _condition(self, wanted: WantedSettings) -> None:
        self.conditions.append(self.off_nm)

    def close(self) -> None:
        self._running = False


@pytest.mark.parametrize(
    ("offs_nm", "refusals", "coupled", "started", "is_person"),
    [
        ([0.1, 0.3, -0.4, 1.9], 0, 0, 1, False),
        # a stall had moved the tip by 48.6 nm in a run of 72 trials, and those after it missed the sample
        ([-0.2, -48.8, 0.1, 0.2, 0.0], 0, 1, 1, False),
        # a person's rig is not started anew under their hands
        ([0.0, 65.8, 65.8, 0.1, 65.8, -0.1, 0.2], 1, 3, 1, True),
        # a simulated hand's is, where both cannot be coupled
        ([0.0, 65.8, 0.1, 0.0, 0.0], 1, 1, 2, False),
    ],
)
def test_a_coupling_that_has_moved_costs_no_trial(
    tmp_path: Path, offs_nm: list[float], refusals: int, coupled: int, started: int, is_person: bool
) -> None:
    plan = plan_of(tmp_path, operator={"kind": "person" if is_person else "simulated"})
    live = Moved(plan, tmp_path, list(offs_nm), refusals)
    trial = plan.trials("P01")[0]
    document = plan.document(trial.settings, "")
    wanted = wanted_of(document, 1)
    assert bool(wanted.operator) != is_person
    for _ in range(4):
        live._rig_in(trial, document, wanted)
    assert len(live.conditions) == 4 and max(map(abs, live.conditions)) <= 2.0
    assert (live.coupled, live.started) == (coupled, started)


def test_where_a_person_cannot_be_coupled_the_run_ends_with_the_reason(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, operator={"kind": "person"})
    live = Moved(plan, tmp_path, [65.8] * 20, refusals=9)
    trial = plan.trials("P01")[0]
    document = plan.document(trial.settings, "")
    with pytest.raises(RigError, match="the hand presses"):
        live._rig_in(trial, document, wanted_of(document, 1))
    assert not live.conditions and (live.coupled, live.started) == (3, 1)


def test_a_law_that_keeps_the_tip_elsewhere_is_coupled_once_for_each_trial_and_goes_on(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, operator={"kind": "simulated"})
    live = Moved(plan, tmp_path, [65.8] * 4)
    trial = plan.trials("P01")[0]
    document = plan.document(trial.settings, "")
    for _ in range(2):
        live._rig_in(trial, document, wanted_of(document, 1))
    assert live.conditions == [65.8, 65.8] and (live.coupled, live.started) == (2, 1)


class Across(Live):
    """A rig whose hand still comes to rest across: what the tip is told first, the hand undoes."""

    def __init__(self, plan: Any, folder: Path, undone: int) -> None:
        super().__init__(plan, folder, Desk(plan))
        self.place_m, self.told, self.undone = (-295e-9, 0.0), 0, undone

    def _states(self) -> dict[str, Any]:
        tip = SimpleNamespace(base_position_m=(*self.place_m, 0.0))
        return {"afm/state": tip, "haptic/state": SimpleNamespace(position_m=(-8e-3, 0.0, 0.0))}

    def _command(self, name: Any, target: str, parameters: Any = None) -> None:
        assert (name, target) == ("set", "afm_node@slave")
        self.told += 1
        if self.told > self.undone:
            self.place_m = (parameters["lateral.x_m"], parameters["lateral.y_m"])


@pytest.mark.parametrize("undone", [0, 1, 3])
def test_the_tip_is_told_of_its_place_over_the_sample_until_it_is_there(tmp_path: Path, undone: int) -> None:
    plan = plan_of(tmp_path)
    across = {"mode": "position", "position_scale": 5e-5}
    document = {**plan.document(plan.trials("P01")[0].settings, ""), "controller": {"lateral": across}}
    document["haptic_node"] = {"lateral": {}}
    rig = Across(plan, tmp_path, undone)
    rig._prepare_sample(document)
    assert rig.told == undone + 1
    assert rig.place_m == pytest.approx((-400e-9, 0.0), abs=1e-15)
