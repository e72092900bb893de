"""Columns of curves go by their names in several languages, and a course has the parts that were put in."""

import numpy as np
import pytest

from telenano.files import orientation_of, parts_of, role_of

ROLES = {
    "base": (
        "z",
        "Z sensor",
        "Piezo",
        "height (measured)",
        "Höhe",
        "Hauteur",
        "Altura",
        "Altezza",
        "Weg",
        "ZSnsr",
        "高度",
    ),
    "separation": ("separation", "tip-sample distance", "Tip-Sample Separation", "Separación", "Abstand Spitze-Probe"),
    "force": ("Force", "F", "Kraft", "Normalkraft", "Fuerza", "Vertical force", "力", "Сила"),
    "deflection": ("Defl", "Vertical", "Auslenkung", "Déflexion", "Flèche", "vDeflection", "A-B", "偏转"),
    "lateral": ("Lateral", "Friction force", "Torsion", "Reibung", "Querkraft", "Frottement", "hDeflection", "摩擦"),
    "amplitude": ("Amplitude", "Schwingungsamplitude", "振幅"),
    "time": ("t", "Zeit", "temps"),
    "": ("Ch1", "signal", "sample", "x"),
}


@pytest.mark.parametrize(("role", "name"), [(role, name) for role, names in ROLES.items() for name in names])
def test_a_name_says_what_a_column_has(role: str, name: str) -> None:
    assert role_of(name) == role


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_course_has_its_ways_and_rests(sign: float, noise: float) -> None:
    way = np.linspace(0.0, 300.0, 500)
    draw = np.random.default_rng(0)
    course = np.concatenate([np.zeros(150), way, np.full(200, 300.0), way[::-1]])
    parts = parts_of(sign * (course + noise * draw.standard_normal(len(course))))
    assert [part.direction for part in parts] == [0, int(sign), 0, -int(sign)]
    edges = np.array([part.start for part in parts])
    np.testing.assert_allclose(edges, [0, 150, 650, 850], atol=30)
    assert parts[-1].end == len(course)


@pytest.mark.parametrize("away", [1.0, -1.0])
@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize("pull", [0.0, 20.0])
@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_curve_with_a_free_part_tells_where_the_sample_is(
    away: float, turned: float, pull: float, share: float
) -> None:
    # height over the sample, and a contact over a share of the way
    height = np.linspace(100.0 * (1.0 - share), -100.0 * share, 400)
    value = np.where(height < 0.0, -height, 0.0) - pull * np.exp(-np.abs(height) / 4.0)
    found = orientation_of(away * height, turned * value + 7.0, falls_first=bool(away > 0.0))
    assert (found.away, found.turned, found.is_free) == (away, turned, True)
