"""Truth and estimate are two things: what plans and looks cannot know where the particles of the simulation are."""

import ast
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "telenano_lab" / "assembly"


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
