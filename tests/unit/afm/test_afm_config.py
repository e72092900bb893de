import math

import pytest
from pydantic import ValidationError

from telenano.afm.sim import SimulatedInstrument, simulated_afm
from telenano.sections.afm_parts import CantileverConfig, SafetyConfig, TipSampleConfig
from telenano.sections.afm_section import AfmConfig


def walk(model):
    for name, field in model.model_fields.items():
        yield f"{model.__name__}.{name}", field
        if hasattr(field.annotation, "model_fields"):
            yield from walk(field.annotation)


def test_every_field_is_described():
    undescribed = [name for name, field in walk(AfmConfig) if not field.description]
    assert undescribed == []


def test_the_default_is_table_2():
    params = AfmConfig().to_params()
    assert round(params.plant.tip.table.contact.transition, 5) == 0.82538
    assert params.plant.stiffness_n_per_m == 40.0
    assert params.plant.rest_distance_m == 10e-9
    assert params.plant.tip.meniscus_width_m == 2.4e-9
    assert params.safety.command_deadline_s == 0.050


def test_humidity_sets_the_meniscus():
    wet = AfmConfig(tip_sample=TipSampleConfig(relative_humidity=0.6376281516))
    assert math.isclose(wet.to_params().plant.tip.meniscus_width_m, 2.4e-9, rel_tol=1e-9)
    with pytest.raises(ValidationError, match="either meniscus_radius_m or relative_humidity"):
        TipSampleConfig(relative_humidity=0.5, meniscus_radius_m=1e-9)


def test_the_table_reaches_beyond_the_force_limit():
    config = AfmConfig(safety=SafetyConfig(force_limit_n=1e-6))
    assert math.isclose(config.to_params().plant.tip.table.end_force_n, 2e-6, rel_tol=1e-6)


@pytest.mark.parametrize(
    ("data", "where"),
    [
        ({"stifness": 1.0}, "stifness"),
        ({"cantilever": {"stiffness_n_per_m": 0.0}}, "cantilever.stiffness_n_per_m"),
        ({"cantilever": {"stiffness_n_per_m": "40"}}, "cantilever.stiffness_n_per_m"),
        ({"cantilever": {"stiffness_n_per_m": math.nan}}, "cantilever.stiffness_n_per_m"),
        ({"tip_sample": {"sigma_m": 3.49}}, "tip_sample.sigma_m"),
        ({"tip_sample": {"preset": "table_3"}}, "tip_sample.preset"),
        ({"mode": "printed"}, "mode"),
        ({"safety": {"hold_time_s": -0.1}}, "safety.hold_time_s"),
        ({"safety": {"retract_position_m": -300e-9}}, "safety"),
        ({"safety": {"base_max_m": -150e-9}}, "safety"),
        ({"rest_distance_m": 0.0}, "rest_distance_m"),
    ],
)
def test_a_bad_value_is_named_by_its_key(data, where):
    with pytest.raises(ValidationError) as caught:
        AfmConfig.model_validate(data)
    assert [".".join(str(part) for part in error["loc"]) for error in caught.value.errors()] == [where]


def test_what_has_no_model_is_refused_on_reading():
    with pytest.raises(ValidationError, match=r"lambda = .* H = 1e-20 J, omega = 0\.072"):
        AfmConfig(tip_sample=TipSampleConfig(hamaker_j=1e-20))
    AfmConfig(tip_sample=TipSampleConfig(hamaker_j=1e-20), mode="as_printed")
    with pytest.raises(ValidationError, match="delta_b = 2e-09 m must lie beyond 2 r1"):
        AfmConfig(tip_sample=TipSampleConfig(break_distance_m=2e-9))


def test_zero_is_legal_where_it_means_something():
    assert SafetyConfig(hold_time_s=0.0).hold_time_s == 0.0
    assert (
        AfmConfig(tip_sample=TipSampleConfig(liquid_energy_j_per_m2=0.0)).to_params().plant.tip.capillary_force_n == 0.0
    )
    assert CantileverConfig(stiffness_n_per_m=1).stiffness_n_per_m == 1.0


def test_material_that_contradicts_itself_is_doubted_and_table_2_is_not():
    assert AfmConfig().doubts() == ""
    # metal in H, polymer in omega: 1.89e-19 J beside 0.01 J/m^2, to which 1.03e-20 J belongs
    doubts = AfmConfig(tip_sample=TipSampleConfig(work_of_adhesion_j_per_m2=0.01)).doubts()
    assert "by a factor of 18" in doubts
    assert "belongs to 1.03e-20 J" in doubts


def test_material_without_a_hand_over_says_which_hamaker_constant_would_do():
    with pytest.raises(ValidationError, match="raise H to") as caught:
        AfmConfig(tip_sample=TipSampleConfig(hamaker_j=1e-20))
    told = float(str(caught.value).split("raise H to ")[1].split(" J")[0])
    assert "0.072 J/m^2" in str(caught.value)
    assert 1e-20 < told < 1e-17
    AfmConfig(tip_sample=TipSampleConfig(hamaker_j=1.02 * told))
    with pytest.raises(ValidationError):
        AfmConfig(tip_sample=TipSampleConfig(hamaker_j=0.97 * told))


def _ends():
    found = []
    for section in ("cantilever", "tip_sample", "safety", "spring", ""):
        model = AfmConfig.model_fields[section].annotation if section else AfmConfig
        for key, schema in model.model_json_schema()["properties"].items():
            kind = schema.get("anyOf", [schema])[0]
            if kind.get("type") == "number":
                low = kind.get("minimum", math.nextafter(kind.get("exclusiveMinimum", 0.0), math.inf))
                high = kind.get("maximum", math.nextafter(kind.get("exclusiveMaximum", 1.0), 0.0))
                found += [(section, key, low), (section, key, high)]
    return found


@pytest.mark.parametrize(("section", "key", "value"), _ends())
def test_the_instruments_give_numbers_at_every_end_of_their_settings(section, key, value):
    try:
        found = AfmConfig.model_validate({section: {key: value}} if section else {key: value})
    except ValidationError as error:
        # what has no model, or contradicts another key, is refused in words
        assert "Value error" in str(error)
        return
    limits = found.safety
    for instrument in (simulated_afm(found.to_params()), SimulatedInstrument(found.to_spring_params())):
        instrument.open()
        for base_m in (limits.base_min_m, 0.0, limits.base_max_m, limits.retract_position_m):
            sample = instrument.exchange(base_m)
            assert all(math.isfinite(part) for part in sample), (section, key, value, sample)
