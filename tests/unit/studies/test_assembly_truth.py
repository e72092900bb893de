"""Truth and estimate are two things: what plans and looks cannot know where the particles of the simulation are."""

import ast
from pathlib import Path
from typing import Literal

import pytest

from proto import TOPICS
from proto.instrument import AfmParticles
from services.afm_node import node as afm
from services.controller.node import HALVES
from services.haptic_node import node as haptic
from services.viz_node.source import TOPICS_SHOWN

FOLDER = Path(__file__).parents[3] / "studies" / "assembly"


@pytest.mark.parametrize("module", ["find", "drift", "plan", "figure", "patterns"])
def test_find_and_plan_import_nothing_that_knows_the_truth(module: str) -> None:
    tree = ast.parse((FOLDER / f"{module}.py").read_text(encoding="utf-8"))
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {name for name in imported if name and ("virtual" in name or "layer" in name or name.endswith(".push"))}


def test_who_assembles_asks_the_bench_for_images_and_pushes_only() -> None:
    tree = ast.parse((FOLDER / "run.py").read_text(encoding="utf-8"))
    (assembler,) = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Assembler"]
    asked = {
        node.attr
        for node in ast.walk(assembler)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and node.value.attr == "_bench"
    }
    assert asked == {"image", "push", "time_s"}
    assert not {node.attr for node in ast.walk(assembler) if isinstance(node, ast.Attribute)} & {
        "device",
        "moving",
        "truth",
    }


ROOT = FOLDER.parents[1]
TRUTH = "afm/particles"
# These are the table of topics, what writes it into recordings, and what judges a trial of an experiment afterwards;
# docs and generated files of the contract are no readers.
SAYS_IT = {
    "proto/topics.py",
    "services/afm_node/node.py",
    "studies/assembly/recording.py",
    "packages/telenano-experiments/telenano_experiments/recorded_trial.py",
    "packages/telenano-experiments/telenano_experiments/tasks/push_particle.py",
}


def test_no_code_names_the_topic_of_the_truth_but_what_says_it() -> None:
    folders = ("proto", "presets", "recording", "services", "analysis", "studies", "telenano", "packages")
    names = set()
    for folder in folders:
        for path in (ROOT / folder).rglob("*"):
            ours = path.suffix in (".py", ".ts", ".yaml") and not {"node_modules", "dist"} & set(path.parts)
            if ours and TRUTH in path.read_text(encoding="utf-8"):
                names.add(str(path.relative_to(ROOT)))
    assert names == SAYS_IT


def test_the_truth_is_recorded_and_goes_to_no_other_machine_and_to_no_node() -> None:
    row = TOPICS[TRUTH]
    assert row.recorded and row.bridged is None and row.publishers == ("afm_node",)
    inputs = (afm.INPUTS, *(half.inputs for half in HALVES.values()), haptic.INPUTS, TOPICS_SHOWN)
    assert not any(TRUTH in topics for topics in inputs)


def test_a_message_of_the_truth_is_marked_as_simulated() -> None:
    fields = AfmParticles.model_fields
    assert fields["simulated"].annotation == Literal[True]
