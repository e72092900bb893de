"""What an experiment changes of a simulated sample by `set`: the stiffness of a spring, and all back as it was."""

from typing import Any

import pytest
from telenano_lab.assembly import bench
from test_afm_programs import SOFT, Imager, command

from services.afm_node.node import AfmNode
from telenano.afm.sim import simulated_afm
from telenano.sections.afm_section import AfmConfig
from telenano.wire.errors import RefusedError

SPRING = {"environment": "spring", "spring": {"stiffness_n_per_m": 2.0, "rest_position_m": -1e-8, "bilateral": False}}
KEY = "spring.stiffness_n_per_m"


def force_n(afm: Imager) -> float:
    """Return the force on the tip where the command of the bench wants the base: 10 nm within the spring."""
    for _ in range(300):
        afm.bench.clock.advance_ns(1_000_000)
        afm.node.on_message(command(afm))
    return float(afm.bench.take("afm/state")[-1].tip_force_n[2])


@pytest.fixture
def spring(bench_of: Any) -> Imager:
    afm = Imager(bench_of("afm_node@slave"), SPRING)
    afm.node.on_message(command(afm))
    fields = {"id": "b", "command": "arm", "target": "afm_node", "parameters": {"place_m": 0.0, "speed_m_per_s": 1e-6}}
    afm.node.on_control(afm.bench.make("session/control", "console@master", **fields))
    return afm


def test_the_sample_is_stiffer_from_then_on(spring: Imager) -> None:
    soft_n = force_n(spring)
    assert soft_n > 0.0
    assert spring.set(**{KEY: 5.0}) == "the sample has 5 N/m"
    assert force_n(spring) == pytest.approx(2.5 * soft_n, rel=1e-9, abs=0.0)
    with pytest.raises(ValueError, match="a re-run must begin before that"):
        spring.node.capture()


@pytest.mark.parametrize("value", [0.0, -1.0, 2e9, True, "stiff"])
def test_what_is_no_stiffness_changes_nothing(spring: Imager, value: Any) -> None:
    before_n = force_n(spring)
    with pytest.raises(RefusedError, match=r"spring.stiffness_n_per_m: .* must be a number of N/m"):
        spring.set(**{KEY: value})
    assert force_n(spring) == before_n
    assert spring.node.capture() is not None


@pytest.mark.parametrize(
    "refused", [{"sample.restore": False}, {"disturbances.thermal.enabled": True}], ids=["restore", "disturbances"]
)
def test_a_command_that_is_refused_changes_nothing_of_the_simulation(spring: Imager, refused: dict[str, Any]) -> None:
    before_n = force_n(spring)
    with pytest.raises(RefusedError, match=next(iter(refused)).partition(".")[0]):
        spring.set(**{KEY: 5.0}, **refused)
    assert force_n(spring) == before_n
    assert spring.node.capture() is not None


def test_a_real_sample_has_its_own(bench_of: Any) -> None:
    with pytest.raises(RefusedError, match="only the simulated environment spring has one"):
        Imager(bench_of("afm_node@slave"), SOFT).set(**{KEY: 5.0})


def test_particles_lie_where_they_lay_again(bench_of: Any) -> None:
    config = AfmConfig.model_validate(bench({"places": [[1e-6, 0.0], [0.0, 1e-6]]}))
    driver = simulated_afm(config.to_params(), config.to_surface(), layer=config.with_layers)
    afm = Imager(bench_of("afm_node@slave"))
    afm.node = AfmNode(bench_of("afm_node@slave").context, config, driver)
    moved = driver.state.part.moving.copy()
    moved[0, 0] += 3e-7
    driver.state.part = driver.state.part._replace(moving=moved)
    assert driver.truths["particles"].places_m[0, 0] == pytest.approx(1.3e-6, rel=1e-9, abs=0.0)
    assert afm.set(**{"sample.restore": True}) == "the sample is as it was in the beginning"
    assert driver.truths["particles"].places_m.tolist() == [[1e-6, 0.0], [0.0, 1e-6]]
    # unlike another stiffness it is in the state, from which a re-run goes on
    assert afm.node.capture() is not None
    with pytest.raises(RefusedError, match=r"sample\.restore: must be true"):
        afm.set(**{"sample.restore": False})
