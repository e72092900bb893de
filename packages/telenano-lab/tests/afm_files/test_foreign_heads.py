"""Force curves below heads of many kinds, with columns of many roles: read right, refused, or said to be a guess."""

from pathlib import Path

import numpy as np
import pytest
from foreign_heads import HALF_KNOWN, KINDS, UNKNOWN, Kind, outcome
from telenano_lab.afm_files.curve_files import load_one

FEW = 8


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_no_curve_is_read_wrongly_without_a_word(kind: Kind, tmp_path: Path) -> None:
    found = [outcome(kind, seed, tmp_path) for seed in range(FEW)]
    for one in found:
        assert not one.wrong or any("guess" in word or "extreme value" in word for word in one.said), one
    if kind not in (*UNKNOWN, *HALF_KNOWN):
        assert not any(one.reason for one in found)


@pytest.mark.endurance
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_of_200_curves_of_a_kind_none_is_read_wrongly_without_a_word(kind: Kind, tmp_path: Path) -> None:
    found = [outcome(kind, seed, tmp_path) for seed in range(1000, 1200)]
    assert not [one for one in found if one.wrong and not any("guess" in w or "extreme" in w for w in one.said)]
    if kind not in (*UNKNOWN, *HALF_KNOWN):
        assert sum(bool(one.reason) for one in found) <= 0.4 * len(found)


def test_the_sign_that_a_person_says_is_taken_and_printed(tmp_path: Path) -> None:
    path = tmp_path / "c.txt"
    z = np.linspace(5.0, -40.0, 200)
    rows = "".join(f"{a:.4f}\t{b:.4f}\n" for a, b in zip(z, 20.0 - 0.5 * z, strict=True))
    path.write_text(f"z [nm]\tForce [nN]\n{rows}", encoding="utf-8")
    guessed, (_, first) = load_one(str(path), "0", "0.5")
    assert any("guess" in remark for remark in guessed["remarks"])
    said, (_, second) = load_one(str(path), "0", "0.5", None, '{"value_sign": "-1"}')
    assert np.array_equal(first, -second)
    assert any("value_sign=-1" in word for word in said["remarks"])
    with pytest.raises(ValueError, match="must be 1 or -1"):
        load_one(str(path), "0", "0.5", None, '{"value_sign": "2"}')
