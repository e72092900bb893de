"""What the base cannot reach: programs are refused or end in a stated time, and files are levelled into reach."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from telenano_lab.microscopy.image_files import Image, write_gsf
from test_afm_programs import QUICK, Imager

from services.afm_node.node import AfmNode
from telenano.afm.programs.reach import Reach
from telenano.afm.sample.surface import Surface, checked, plane_levelled
from telenano.afm.sim import SimulatedInstrument, simulated_afm
from telenano.extend.programs import Span, approach_limit_s
from telenano.extend.stage import Place
from telenano.sections.afm_section import AfmConfig
from telenano.sections.sample_section import SampleConfig
from telenano.wire.errors import RefusedError

DATA = Path(__file__).parents[4] / "shared" / "data" / "spot_1-1000nm.ibw"
LIMITS = AfmConfig().to_params().safety
SOFT = {"cantilever": {"stiffness_n_per_m": 1.0}}


def tilted(x_m: Any, y_m: Any) -> Any:
    return -500e-9 + 0.1 * x_m + 0.05 * y_m


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """Return the file of an image of 2 x 2 um, tilted, 500 nm below 0 as its instrument counted, with a deep hole."""
    middles = (np.arange(40) + 0.5) * 50e-9
    heights = tilted(middles[None, :], middles[:, None])
    heights[0, 0] = -900e-9
    write_gsf(tmp_path / "image.gsf", Image("Height", "m", heights, 2e-6, 2e-6))
    return tmp_path / "image.gsf"


def rig(bench_of: Any, sample: dict[str, Any] | None, **section: Any) -> Imager:
    whole = {**SOFT, **section}
    return Imager(bench_of("afm_node@slave"), whole if sample is None else {**whole, "sample": sample})


def arm(afm: Imager) -> None:
    bench = afm.bench
    command = bench.received(
        "afm/command", "controller@slave", base_position_m=(0.0, 0.0, 100e-9), mode="position",
        hand_seq=0, hand_t_ns=bench.clock.now_ns(), hand_armed=True,
    )  # fmt: skip
    afm.node.on_message(command)
    fields = {"id": "b", "command": "arm", "target": "afm_node", "parameters": {"place": "hand"}}
    afm.node.on_control(bench.make("session/control", "console@master", **fields))


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ({**QUICK, "scan.width_m": 5e-7, "scan.depth_m": 5e-7}, "scan: the surface is out of reach"),
        ({"program": "curve"}, "curve: the surface is out of reach"),
        ({"program": "tactile"}, "tactile: the surface is out of reach"),
    ],
)
def test_a_program_over_a_surface_beyond_the_base_is_refused_with_the_number_and_the_remedy(
    bench_of: Any, image: Path, program: dict[str, Any], said: str
) -> None:
    afm = rig(bench_of, {"name": str(image), "level": "absolute"})
    with pytest.raises(RefusedError, match=said) as refused:
        afm.set(**program)
    text = str(refused.value)
    # the middle is 350 nm below 0, and the base of 200 nm goes 190 nm below it
    assert "safety.base_max_m = 2e-07 m" in text
    assert afm.node._programs.name == ""
    remedy = float(text.partition("afm_node.safety.base_max_m=")[2].split()[0])
    assert remedy < 1e-6
    # what it says is right: with it the program begins, and a nanometre less is refused
    rig(bench_of, {"name": str(image), "level": "absolute"}, safety={"base_max_m": remedy}).set(**program)
    with pytest.raises(RefusedError, match=said):
        rig(bench_of, {"name": str(image), "level": "absolute"}, safety={"base_max_m": remedy - 1.1e-9}).set(**program)


def test_a_file_is_levelled_into_reach_unless_its_own_heights_are_wanted(bench_of: Any, image: Path) -> None:
    by_level = {
        level: SampleConfig.model_validate({"name": str(image), "level": level}).build().height_m
        for level in ("centre", "plane", "absolute")
    }
    assert np.array_equal(SampleConfig(name=str(image)).build().height_m, by_level["centre"])
    # only shifted: what is seen in the file is seen by the tip
    shift = by_level["absolute"] - by_level["centre"]
    assert shift == pytest.approx(np.full((40, 40), -350e-9), rel=1e-6, abs=0.0)
    assert abs(by_level["plane"].mean()) < 1e-15
    afm = rig(bench_of, {"name": str(image)})
    answer = afm.set(**{**QUICK, "scan.width_m": 5e-7, "scan.depth_m": 5e-7, "scan.dwell_s": 20e-3, "scan.lines": 1})
    assert answer == "an image of 24 x 1 pixels begins, 1 s for its lines after an approach of at most 1.3 s"
    afm.run()
    assert afm.outcome()[0] == "finished"
    line = afm.bench.take("afm/scanline")[0].height_m.to_numpy()
    assert np.ptp(line) == pytest.approx(0.1 * 5e-7 * 23 / 24, rel=0.05, abs=0.0)


def test_a_plane_is_subtracted_as_the_least_squares_fit_has_it() -> None:
    random = np.random.default_rng(3)
    heights = random.normal(0.0, 1e-9, (13, 21))
    y, x = np.mgrid[:13, :21]
    surface = checked(heights + 3e-9 * x - 7e-9 * y + 4e-7, 21e-8, 13e-8)
    parts = np.column_stack([np.ones(x.size), x.ravel(), y.ravel()])
    fitted = parts @ np.linalg.lstsq(parts, surface.height_m.ravel(), rcond=None)[0]
    expected = surface.height_m - fitted.reshape(13, 21)
    assert plane_levelled(surface).height_m == pytest.approx(expected, rel=0.0, abs=1e-20)


def test_a_level_is_for_files_only() -> None:
    with pytest.raises(ValidationError, match="level: is for files; dots has heights of its own"):
        SampleConfig.model_validate({"name": "dots", "level": "plane"})
    assert SampleConfig().levelled == ""


def test_a_sample_from_a_file_says_at_arming_how_it_is_levelled(bench_of: Any, image: Path) -> None:
    afm = rig(bench_of, {"name": str(image)})
    arm(afm)
    said = [event.text for event in afm.bench.take("session/event") if event.text.startswith("sample ")]
    assert said == [
        f"sample {image}: its heights are shifted so that its middle is at 0 (afm_node.sample.level=centre);"
        " the tip sees -5.5e-07 to 1.46e-07 m"
    ]


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"rest_distance_m": 300e-9}, "out of reach: its lowest point, 0 m, needs the base at 3e-07 m, 1e-07 m beyond"),
        ({"rest_distance_m": 1e-9, "safety": {"retract_position_m": 2e-9}}, "the surface is too high"),
        ({}, ""),
    ],
)
def test_a_hand_that_cannot_touch_the_sample_is_told_so_when_the_tip_is_armed(
    bench_of: Any, section: dict[str, Any], said: str
) -> None:
    afm = rig(bench_of, None, **section)
    arm(afm)
    warned = [event.text for event in afm.bench.take("session/event") if event.level == "warning"]
    if not said:
        assert warned == []
    else:
        assert len(warned) == 1
        assert warned[0].startswith("a hand cannot touch the sample here: ")
        assert said in warned[0]


def test_an_image_that_the_retracted_tip_would_hit_is_refused_with_the_base_that_is_clear_of_it(bench_of: Any) -> None:
    sample = {"name": "grating", "size_m": 2e-7, "period_m": 1e-7, "height_m": 1.5e-7, "pixels": 40}
    with pytest.raises(RefusedError, match="scan: the surface is too high") as refused:
        rig(bench_of, sample).set(**QUICK)
    assert "afm_node.safety.retract_position_m=-1.4e-07 or less" in str(refused.value)
    rig(bench_of, sample, safety={"retract_position_m": -1.4e-7}).set(**QUICK)
    # the middle is a groove, in which there is room for a curve and a path
    rig(bench_of, sample).set(program="curve")
    rig(bench_of, sample).set(**{"program": "tactile", "tactile.x1_m": 1e-9})
    # on the ridge there is none for a curve, and it is in the way of a path in the next groove
    afm = rig(bench_of, sample)
    afm.node._memory.place = Place(5e-8, 0.0)
    with pytest.raises(RefusedError, match=r"curve: the surface is too high.* base at -1.4e-07 m or less"):
        afm.set(program="curve")
    with pytest.raises(RefusedError, match="tactile: the surface is too high"):
        rig(bench_of, sample).set(**{"program": "tactile", "tactile.x0_m": 9.5e-8, "tactile.x1_m": 9.4e-8})


class Unknown:
    """An instrument with a stage whose surface nothing is known of: not the simulated one, only its shape."""

    relief = None

    def __init__(self, inner: SimulatedInstrument) -> None:
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def far_away(bench_of: Any) -> Imager:
    afm = rig(bench_of, None, rest_distance_m=1e-6)
    afm.bench = bench_of("afm_node@slave")
    afm.driver = Unknown(simulated_afm(afm.config.to_params()))
    afm.node = AfmNode(afm.bench.context, afm.config, afm.driver)
    return afm


@pytest.mark.check("takes 1.2 s")
@pytest.mark.parametrize("program", ["scan", "tactile"])
def test_an_approach_that_finds_no_surface_ends_in_the_stated_time_with_the_tip_away(
    bench_of: Any, program: str
) -> None:
    afm = far_away(bench_of)
    approach = f"{program}.approach_m_per_s"
    afm.set(**{**(QUICK if program == "scan" else {"program": program}), approach: 1e-7})
    begun_s = afm.bench.clock.monotonic_ns() * 1e-9
    afm.run()
    state, text = afm.outcome()
    assert state == "ended"
    assert "the surface was not found within 4 s, with the base at 2e-07 m (safety.base_max_m is 2e-07 m)" in text
    events = [event for event in afm.bench.take("session/event") if event.data.get("program_state") == "ended"]
    assert [event.level for event in events] == ["warning"]
    # 3 s of way and 1 s to spare, and the retraction
    assert afm.bench.clock.monotonic_ns() * 1e-9 - begun_s < 5.0
    assert afm.mode == "retracted"


def test_a_curve_that_turns_without_its_load_says_so(bench_of: Any) -> None:
    afm = far_away(bench_of)
    afm.set(**{"program": "curve", "curve.speed_m_per_s": 1e-6})
    afm.run()
    assert afm.outcome() == ("finished", "the curve is finished without reaching its load: the tip retracts")
    warned = [event.text for event in afm.bench.take("session/event") if event.level == "warning"]
    assert len(warned) == 1
    assert warned[0].startswith("the curve turned at 2e-07 m, the furthest base (safety.base_max_m), where the force")
    assert warned[0].endswith("its load of 2e-08 N was not reached")


def test_a_curve_that_reaches_its_load_says_nothing_of_it(bench_of: Any) -> None:
    afm = rig(bench_of, None)
    afm.set(**{"program": "curve", "curve.speed_m_per_s": 1e-6})
    afm.run()
    assert afm.outcome() == ("finished", "the curve is finished: the tip retracts")
    assert not [event for event in afm.bench.take("session/event") if event.level == "warning"]


def test_heights_are_those_of_the_pixels_that_a_part_touches() -> None:
    heights = np.array([[float(f"{5 * row + column}e-9") for column in range(5)] for row in range(4)])
    reach = Reach(Surface(heights, 1e-8, 1e-8), 10e-9, LIMITS)
    # the middle of the map is the middle of pixel 2 of rows 1 and 2
    assert reach.within(Place(0.0, 0.0), 1e-12, 1e-12) == (6e-9, 13e-9)
    assert reach.within(Place(0.0, 0.0), 1.0, 1.0) == (0.0, 19e-9)
    assert reach.within(Place(9e-9, 5e-9), 1e-9, 1e-10) == (7e-9, 18e-9)
    assert reach.along(Place(-1.0, -1.0), Place(-1.0, 1.0)) == (0.0, 15e-9)
    # beside a point, up to four pixels; at the edge of the map the outer one
    assert reach.along(Place(2e-9, -2e-9), Place(2e-9, -2e-9)) == (7e-9, 13e-9)
    assert reach.along(Place(1.0, 1.0), Place(1.0, 1.0)) == (19e-9, 19e-9)
    # of a diagonal what it passes, and not the corners beside it
    assert reach.along(Place(-2e-8, -1.5e-8), Place(2e-8, 1.5e-8)) == (0.0, 19e-9)
    assert reach.along(Place(-2e-8, 1.5e-8), Place(2e-8, -1.5e-8)) == (2e-9, 17e-9)
    plane = Reach(None, 10e-9, LIMITS)
    assert plane.within(Place(0.0, 0.0), 1.0, 1.0) == plane.along(Place(0.0, 0.0), Place(1.0, 1.0)) == Span(0.0, 0.0)


def test_reach_ends_where_the_base_does() -> None:
    reach = Reach(None, 10e-9, LIMITS)
    # the lowest height that a base of 200 nm touches with 5 nm of deflection, and the highest below a base of -100 nm
    lowest, highest = Span(-185e-9, 0.0), Span(0.0, 110e-9)
    assert reach.depth_fault(Span(math.nextafter(-185e-9, 0.0), 0.0), 5e-9) == ""
    assert reach.depth_fault(lowest._replace(low_m=-185.01e-9), 5e-9) != ""
    assert reach.retracted_fault(Span(0.0, math.nextafter(110e-9, 0.0))) == ""
    assert reach.retracted_fault(highest._replace(high_m=110.01e-9)) != ""
    assert reach.retracted_fault(Span(0.0, 100e-9), 9e-9) == "" != reach.retracted_fault(Span(0.0, 100e-9), 11e-9)
    # no faster than the base goes
    assert approach_limit_s(LIMITS, -100e-9, 100e-9) == pytest.approx(4.0, rel=1e-12, abs=0.0)
    assert approach_limit_s(LIMITS, -100e-9, 1e-3) == pytest.approx(1.15, rel=1e-12, abs=0.0)


@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_topography_is_in_reach_as_it_is_loaded(bench_of: Any) -> None:
    window = {**QUICK, "scan.width_m": 2e-6, "scan.depth_m": 2e-6, "scan.dwell_s": 8e-3, "scan.lines": 1}
    afm = rig(bench_of, {"name": str(DATA)})
    afm.set(**window)
    afm.run()
    assert afm.outcome()[0] == "finished"
    with pytest.raises(RefusedError, match=r"scan: the surface is out of reach.* 4.73e-07 m beyond safety.base_max_m"):
        rig(bench_of, {"name": str(DATA), "level": "absolute"}).set(**window)
    # the whole of it is higher than the tip is raised, and that is said as well
    with pytest.raises(RefusedError, match=r"scan: the surface is too high.*retract_position_m="):
        rig(bench_of, {"name": str(DATA)}).set(**{**QUICK, "scan.dwell_s": 0.1})
