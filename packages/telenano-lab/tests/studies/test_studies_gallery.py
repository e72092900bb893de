"""The gallery of delay: its shipped data are what the laws' own steps and the theory give today."""

import json

import numpy as np
import pytest
from telenano_lab.studies.option_values import COMPARED_LAWS
from telenano_lab.studies.pages.gallery import DELAYS_MS, FOLDER, cell_of, page_of, shown

AGAIN = "run `telenano study gallery --out out/gallery` and copy its gallery.json to services/viz_node/web/gallery"


@pytest.fixture(scope="module")
def document() -> dict[str, object]:
    found: dict[str, object] = json.loads((FOLDER / "gallery.json").read_text(encoding="utf-8"))
    return found


def test_every_law_is_shown_at_every_delay(document: dict[str, object]) -> None:
    assert [law["law"] for law in document["laws"]] == list(COMPARED_LAWS)
    assert document["delays_ms"] == list(DELAYS_MS)
    for law in document["laws"]:
        assert len(law["cells"]) == len(DELAYS_MS)
        assert all(("nyquist" in cell) == ("roots" in cell) == law["linear"] for cell in law["cells"])


@pytest.mark.parametrize(
    ("law", "delay_ms"),
    [
        ("virtual_impedance", 45.0),
        ("virtual_impedance", 50.0),
        *(pytest.param(law, 120.0, marks=pytest.mark.endurance) for law in COMPARED_LAWS),
    ],
)
def test_the_shipped_data_are_those_of_today(document: dict[str, object], law: str, delay_ms: float) -> None:
    (about,) = (one for one in document["laws"] if one["law"] == law)
    found, there = shown(cell_of(law, delay_ms)), about["cells"][DELAYS_MS.index(delay_ms)]
    for name in ("verdict", "reason", "force", "energy"):
        assert found[name] == there[name], AGAIN
    assert set(found) == set(there)
    if about["linear"]:
        # linear algebra rounds as a library chooses
        assert np.allclose(found["roots"], there["roots"], rtol=0, atol=2e-4), AGAIN
        for part, kept in zip(found["nyquist"], there["nyquist"], strict=True):
            assert np.abs(np.cumsum(part) - np.cumsum(kept)).max() <= 1, AGAIN


def test_verdicts_change_at_the_margin_of_theory_and_roots_cross_there(document: dict[str, object]) -> None:
    for law in document["laws"]:
        for delay_ms, cell in zip(DELAYS_MS, law["cells"], strict=True):
            if not law["linear"]:
                continue
            inside = law["critical_ms"] is None or delay_ms < law["critical_ms"]
            assert (cell["verdict"] == "stable") is inside
            assert all(growth < 0.0 for growth, _ in cell["roots"]) is inside


def test_a_law_that_promises_energy_makes_none_and_one_that_diverged_did(document: dict[str, object]) -> None:
    for law in document["laws"]:
        lowest_mj = min(cell["lowest_mj"] for cell in law["cells"])
        assert (lowest_mj >= -1e-3) is (law["law"] in ("wave", "passivity"))


def test_the_page_is_one_file_and_nothing_in_its_data_ends_a_script(document: dict[str, object]) -> None:
    page = page_of({**document, "hand": [[0.0, 0.0], [0.6, 1.0]], "note": "</script><b>"})
    assert page.count("</script>") == 2
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert "src=" not in page and "import " not in page
