"""The notebooks of docs/notebooks keep what their cells print and draw, and a fresh run prints and draws the same."""

import math
import re
from pathlib import Path

import pytest
from documented_lines import differing
from kept_notebooks import NOTEBOOKS, Document, document_of, executed, experiment_in, pictures_of, text_of

MOST_BYTES = 60_000
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# Of a machine: a folder of a user or of the system, and the file of a kernel.
PATH = re.compile(r"(?<![\w./])/(?:home|root|tmp|usr|opt|var|work|Users)/|ipykernel_")
DEEPER_THAN_A_FACE = re.compile(r"^\s*(?:from|import) telenano\.(?!extend\b)\w+\.\w+", re.MULTILINE)


def cells_of(document: Document) -> list[Document]:
    return [cell for cell in document["cells"] if cell["cell_type"] == "code"]


def differs(kept: str, fresh: str) -> str:
    """Return the first place where two texts differ by more than the last digits of a number; empty where none does."""
    words = [NUMBER.sub("#", text).split() for text in (kept, fresh)]
    if words[0] != words[1]:
        return f"{kept!r} is kept, and a fresh run says {fresh!r}"
    for one, other in zip(NUMBER.findall(kept), NUMBER.findall(fresh), strict=True):
        if not math.isclose(float(one), float(other), rel_tol=2e-3, abs_tol=1e-15):
            return f"{one} is kept, and a fresh run says {other}"
    return ""


def test_a_difference_of_a_number_or_a_word_is_found() -> None:
    assert differs("force 1.000 nN\nat rest", "force 1.001 nN at rest") == ""
    assert differs("force 1.000 nN", "force 1.003 nN") == "1.000 is kept, and a fresh run says 1.003"
    assert differs("1e-9 N", "2e-9 N") == "1e-9 is kept, and a fresh run says 2e-9"
    assert differs("stable", "limit_cycle")
    assert differs("1 2", "1")


def test_four_notebooks_are_kept() -> None:
    assert [path.stem for path in NOTEBOOKS] == [
        "experiment_table",
        "fig12_against_delay",
        "recording_to_figure",
        "thirty_sessions",
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_has_its_outputs_and_nothing_of_a_machine(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text) <= MOST_BYTES
    assert not PATH.search(text)
    cells = cells_of(document_of(path))
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert all(cell["metadata"] == {} for cell in cells), "times of a run"
    assert all(output.get("name") != "stderr" for cell in cells for output in cell["outputs"])
    assert sum(bool(text_of(cell)) for cell in cells) >= len(cells) - 1
    assert len([picture for cell in cells for picture in pictures_of(cell)]) == 1
    assert all(not DEEPER_THAN_A_FACE.search("".join(cell["source"])) for cell in cells)


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return experiment_in(tmp_path_factory.mktemp("experiment"))


@pytest.mark.check("runs a notebook")
@pytest.mark.parametrize(
    "path",
    [
        # The others simulate for a minute each.
        pytest.param(path, id=path.stem, marks=[] if path.stem == "recording_to_figure" else [pytest.mark.endurance])
        for path in NOTEBOOKS
    ],
)
def test_a_fresh_run_prints_and_draws_what_is_kept(path: Path, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    # One of them reads the tables of an experiment, which takes longer than the notebook.
    experiment = request.getfixturevalue("experiment") if path.stem == "experiment_table" else tmp_path
    fresh = cells_of(executed(path, tmp_path, experiment))
    for number, (kept, made) in enumerate(zip(cells_of(document_of(path)), fresh, strict=True)):
        assert differs(text_of(kept), text_of(made)) == "", number
        for old, new in zip(pictures_of(kept), pictures_of(made), strict=True):
            (tmp_path / "kept.png").write_bytes(old)
            (tmp_path / "made.png").write_bytes(new)
            assert differing(tmp_path / "made.png", tmp_path / "kept.png") < 0.02, number
