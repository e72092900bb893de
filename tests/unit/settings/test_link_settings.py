import re
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from telenano.settings.link_settings import DirectionSettings, Impairment, LinkSettings, changes_text, profile_changes
from telenano.settings.network_profiles import PROFILES
from telenano.wire.errors import ConfigError

REPOSITORY = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("flat", "key", "reason"),
    [
        (
            {"forward.delay_s": -0.01},
            "forward.delay_s",
            "greater than or equal to 0 (allowed is from 0 to 3600), got -0.01",
        ),
        ({"forward.delay_s": float("nan")}, "forward.delay_s", "finite"),
        ({"forward.delay_s": "20 ms"}, "forward.delay_s", "valid number"),
        ({"backward.loss.probability": 1.5}, "backward.loss.probability", "(allowed is from 0 to 1), got 1.5"),
        ({"backward.los": 0.1}, "backward.los", "did you mean loss? Known are delay_s, jitter"),
        ({"backward.loss": 0.1}, "backward.loss", "should be an object, got 0.1"),
        ({"forward.topics.afm/state.jitter.sd": 1}, "forward.topics.afm/state.jitter.sd", "known are scale_s"),
        ({"profile": "mars"}, "profile", "'mars'; known are clean, 4g, 5g, att_driving"),
        ({"profile.name": "lan"}, "profile", "valid string"),
        ({"nothing": 1}, "nothing", "known are profile, seed, forward, backward"),
        ({"forward.jitter.correlation": 1.0}, "forward.jitter.correlation", "less than 1"),
        ({"forward.jitter.pareto_shape": 2.0}, "forward.jitter.pareto_shape", "greater than 2"),
        ({"forward.jitter.distribution": "table"}, "forward.jitter.table_file", "needs a file"),
        (
            {"forward.jitter.distribution": "table", "forward.jitter.table_file": "t.txt"},
            "forward.jitter.scale_s",
            "every sample of the table is multiplied",
        ),
        ({"forward.jitter.distribution": "cauchy"}, "forward.jitter.distribution", "'uniform', 'normal'"),
        ({"forward.order": "link", "forward.reordering.probability": 0.1}, "forward.order", "forbids overtaking"),
        ({"forward.jitter.quantiles": "0:1,0.5:2"}, "forward.jitter.quantiles", "rise from 0 to 1"),
        ({"forward.jitter.quantiles": "0:2,1:1"}, "forward.jitter.quantiles", "smaller value"),
        ({"forward.jitter.quantiles": "0:1,1"}, "forward.jitter.quantiles", "pairs of numbers"),
        (
            {"forward.jitter.correlation": 0.5, "forward.jitter.correlation_time_s": 1.0},
            "forward.jitter.correlation",
            "one of them",
        ),
        (
            {"forward.jitter.second_correlation_share": 0.5, "forward.jitter.correlation_time_s": 1.0},
            "forward.jitter.second_correlation_share",
            "second_correlation_time_s above 0",
        ),
        ({"forward.markov_loss.p13": 0.6, "forward.markov_loss.p14": 0.5}, "forward.markov_loss.p13", "more than 1"),
        ({"forward.markov_loss.p32": 0.1}, "forward.markov_loss.p31", "more than 1"),
        ({"forward.markov_loss.p13": 0.1, "forward.markov_loss.p31": 0.0}, "forward.markov_loss.p31", "never end"),
        ({"forward.gilbert_elliott.p": 0.1, "forward.gilbert_elliott.r": 0}, "forward.gilbert_elliott.r", "never"),
        ({"forward.rate.rate_bytes_per_s": 0.0}, "forward.rate.rate_bytes_per_s", "from 0.001 to 1e+12"),
        ({"forward.rate.rate_bytes_per_s": 1e300}, "forward.rate.rate_bytes_per_s", "from 0.001 to 1e+12"),
        ({"forward.queue.limit_bytes": 2**63}, "forward.queue.limit_bytes", "to 9.22337e+18"),
        ({"seed": 2**64 - 1}, "seed", "to 9.22337e+18"),
        ({"forward.rate.rate_bytes_per_s": 1e6, "forward.delivery_trace.file": "x"}, "forward.rate", "one of them"),
        ({"forward.slots.max_interval_s": 0.1}, "forward.slots.max_interval_s", "slots.min_interval_s"),
        ({"forward.outage.schedule": "1:2, 2:1"}, "forward.outage.schedule", "at 2.0 s begins before"),
        ({"forward.outage.schedule": "soon"}, "forward.outage.schedule", "pairs of numbers"),
        ({"forward.outage.schedule": "1:1", "forward.outage.period_s": 2.0}, "forward.outage.period_s", "longer"),
        ({"forward.outage.mean_up_s": 1.0}, "forward.outage.mean_up_s", "both"),
        (
            {"forward.topics.a.order": "topic", "forward.topics.a.reordering.probability": 1},
            "forward.topics.a",
            "order",
        ),
        ({"forward.topics. a.delay_s": 1}, "forward.topics", "' a' is not a topic pattern"),
        ({"seed": -1}, "seed", "greater than or equal to 0"),
    ],
)
def test_bad_setting_is_refused_naming_the_key_and_what_would_be_right(flat, key, reason):
    good = LinkSettings.of({"forward": {"delay_s": 0.02}})
    with pytest.raises(ConfigError) as error:
        good.changed(flat)
    assert str(error.value).startswith(f"session/control: {key}")
    assert reason in str(error.value)


@pytest.mark.parametrize(
    "flat",
    [
        {"forward.delay_s": 0, "forward.loss.probability": 1, "forward.jitter.correlation": 0},
        {"forward.delay_s": 3600.0, "forward.jitter.pareto_shape": 100.0},
        {"forward.markov_loss.p13": 0.5, "forward.markov_loss.p14": 0.5},
        {"forward.markov_loss.p31": 0.0},
        {"forward.gilbert_elliott.r": 0.0, "forward.gilbert_elliott.loss_in_good": 0.1},
        {"forward.outage.schedule": "1:1, 2:1", "forward.outage.period_s": 3.001},
        {"forward.slots.min_interval_s": 0.01, "forward.slots.max_interval_s": 0.01},
        {"forward.queue.limit_messages": 0, "forward.rate.rate_bytes_per_s": 1e-3},
    ],
)
def test_settings_at_the_edge_of_what_makes_sense_are_accepted(flat):
    settings_now = LinkSettings().changed(flat).flattened()
    assert {key: settings_now[key] for key in flat if key != "forward.outage.schedule"} == {
        key: value for key, value in flat.items() if key != "forward.outage.schedule"
    }


def test_every_wrong_key_gets_a_line_of_its_own():
    with pytest.raises(ConfigError) as error:
        LinkSettings().changed({"forward.delay_s": -1.0, "backward.loss.probability": 2.0})
    assert [line.split(": ")[:2] for line in str(error.value).splitlines()] == [
        ["session/control", "forward.delay_s"],
        ["session/control", "backward.loss.probability"],
    ]


def test_every_contradiction_is_named_at_its_key_and_an_inherited_one_once():
    topics = {"a.b": {"delay_s": 1}, "x": {}, "y": {"outage": {"mean_up_s": 1}}}
    with pytest.raises(ConfigError) as error:
        LinkSettings.of({"forward": {"order": "topic", "reordering": {"probability": 1}, "topics": topics}}, "rig.yaml")
    assert [line.split(": ")[:2] for line in str(error.value).splitlines()] == [
        ["rig.yaml", "forward.order"],
        ["rig.yaml", "forward.topics"],
        ["rig.yaml", "forward.topics.x"],
        ["rig.yaml", "forward.topics.y.outage.mean_up_s"],
    ]


def test_key_that_is_both_value_and_section_in_one_request_is_refused():
    with pytest.raises(ConfigError, match="session/control: loss "):
        LinkSettings().changed({"forward.loss": 0.1, "forward.loss.probability": 0.2})


def test_tree_that_is_no_mapping_is_refused():
    with pytest.raises(ConfigError, match="link settings: Input should be"):
        LinkSettings.of(None)


def test_change_keeps_the_other_keys():
    before = LinkSettings.of(
        {"seed": 7, "forward": {"delay_s": 0.02, "loss": {"probability": 0.1, "correlation": 0.5}}}
    )
    after = before.changed({"forward.loss.probability": 0.2, "backward.delay_s": 1})
    assert after.forward.loss.probability == 0.2
    assert after.forward.loss.correlation == 0.5
    assert (after.forward.delay_s, after.backward.delay_s, after.seed) == (0.02, 1.0, 7)
    assert before.forward.loss.probability == 0.1


def test_profile_starts_anew_but_keeps_the_seed_and_takes_the_other_keys_of_the_request():
    before = LinkSettings.of({"seed": 7, "forward": {"corruption": {"probability": 0.1}}})
    after = before.changed({"profile": "satellite", "forward.delay_s": 0.4})
    assert after == LinkSettings.of({"profile": "satellite", "seed": 7, "forward": {"delay_s": 0.4}})
    assert after.forward.corruption.probability == 0.0
    assert after.forward.delay_s == 0.4
    assert after.backward.delay_s == PROFILES["satellite"].settings["backward"]["delay_s"]


def test_profile_names_are_known_in_any_case():
    assert LinkSettings().changed({"profile": "LTE"}) == LinkSettings.of({"profile": "lte"})


def test_what_replaces_a_key_of_the_profile_is_named_with_both_values():
    link = LinkSettings.of(
        {
            "profile": "satellite",
            "forward": {"delay_s": 0.0, "loss": {"probability": 0.1}, "queue": {"limit_messages": 5}},
            "backward": {"delay_s": 0.29},
        }
    )
    assert profile_changes(link) == {"forward.delay_s": (0.31, 0.0), "forward.queue.limit_messages": ("none", 5)}
    assert changes_text(link) == (
        "the profile satellite is changed: forward.delay_s is 0.0, not 0.31, "
        "forward.queue.limit_messages is 5, not none"
    )


def test_keys_that_a_profile_does_not_set_replace_nothing_of_it():
    assert changes_text(LinkSettings.of({"forward": {"delay_s": 0.02}})) == ""
    assert changes_text(LinkSettings.of({"profile": "lan", "forward": {"outage": {"period_s": 5.0}}})) == ""


@pytest.mark.parametrize(
    ("given", "name"),
    [
        *(({"profile": name, "seed": 3}, name) for name in PROFILES),
        ({}, "clean"),
        ({"forward": {"delay_s": 0.0, "jitter": {"scale_s": 0.0}}}, "clean"),
        ({"forward": {"delay_s": 0.1}, "backward": {"delay_s": 0.1}}, "constant delay"),
        ({"backward": {"delay_s": 0.1, "loss": {"probability": 0.1}}}, "custom"),
        ({"forward": {"topics": {"afm/state": {"delay_s": 0.1}}}}, "custom"),
        ({"forward": {"reliable": []}}, "custom"),
        ({"profile": "lte", "forward": {"outage": {"period_s": 5.0}}}, "lte, changed"),
        ({"profile": "satellite", "forward": {"delay_s": 0.0}}, "satellite, changed"),
    ],
)
def test_a_network_is_named_by_what_is_in_force(given, name):
    assert LinkSettings.of(given).network_name == name


def test_empty_lists_survive_the_flat_form():
    link = LinkSettings.of({"forward": {"reliable": [], "outage": {"schedule": []}}})
    assert LinkSettings().changed(link.flattened()) == link
    assert link.forward.reliable == ()


def test_profile_clean_is_no_impairment_at_all():
    assert LinkSettings.of({"profile": "lte"}).changed({"profile": "clean"}) == LinkSettings()


@pytest.mark.parametrize("name", PROFILES)
def test_profile_is_valid_and_stays_under_later_changes(name):
    once = LinkSettings.of({"profile": name})
    twice = once.changed({"forward.apply_probability": 0.5})
    assert twice.profile == name
    assert twice.backward == once.backward
    assert twice.forward.jitter == once.forward.jitter


def test_none_takes_a_value_away():
    limited = LinkSettings().changed({"forward.rate.rate_bytes_per_s": 1e6})
    assert limited.forward.rate.rate_bytes_per_s == 1e6
    assert limited.changed({"forward.rate.rate_bytes_per_s": "none"}).forward.rate.rate_bytes_per_s is None


def test_topic_override_inherits_what_it_does_not_name_also_later():
    link = LinkSettings.of({"forward": {"delay_s": 0.1, "topics": {"afm/*": {"loss": {"probability": 0.3}}}}})
    assert link.forward.block("afm/*").delay_s == 0.1
    link = link.changed({"forward.delay_s": 0.2, "forward.loss.correlation": 0.5})
    assert link.forward.block("afm/*").delay_s == 0.2
    assert link.forward.block("afm/*").loss.probability == 0.3
    assert link.forward.block("afm/*").loss.correlation == 0.5
    assert link.forward.block("").loss.probability == 0.0


def test_exact_topic_wins_then_the_first_pattern_that_fits():
    direction = DirectionSettings(
        topics={"*": Impairment(delay_s=0.5), "afm/*": Impairment(delay_s=1.0), "afm/state": Impairment(delay_s=2.0)}
    )
    assert direction.pattern_of("afm/state") == "afm/state"
    assert direction.pattern_of("afm/scanline") == "*"
    assert DirectionSettings().pattern_of("afm/state") == ""


def test_topic_override_without_a_key_is_refused():
    with pytest.raises(ConfigError, match=r"forward\.topics\.afm/state: changes nothing"):
        LinkSettings.of({"forward": {"topics": {"afm/state": {}}}})


def test_lists_come_from_files_and_as_text():
    tree = {"forward": {"outage": {"schedule": [[1, 0.5], [2.5, 1]]}, "reliable": ["session/*", "afm/scanline"]}}
    flat = {"forward.outage.schedule": "1:0.5, 2.5:1", "forward.reliable": "session/*, afm/scanline"}
    assert LinkSettings.of(tree) == LinkSettings().changed(flat)
    assert LinkSettings.of(tree).forward.outage.schedule == ((1.0, 0.5), (2.5, 1.0))


probability = st.floats(0.0, 1.0)
impairments = st.fixed_dictionaries(
    {},
    optional={
        "delay_s": st.floats(0.0, 10.0),
        "jitter": st.fixed_dictionaries({"scale_s": st.floats(0, 1)}, optional={"correlation": st.floats(0, 0.99)}),
        "loss": st.fixed_dictionaries({"probability": probability}),
        "gilbert_elliott": st.fixed_dictionaries({"p": probability, "r": st.floats(0.01, 1.0)}),
        "queue": st.fixed_dictionaries({"limit_messages": st.none() | st.integers(0, 100)}),
        "outage": st.fixed_dictionaries({"schedule": st.just([[0.5, 0.25], [1.0, 2.0]])}),
        "order": st.sampled_from(["any", "topic", "link"]),
    },
)


@pytest.mark.check("takes 0.9 s")
@settings(max_examples=100)
@given(
    # A profile with a table refuses a scale of 0.
    profile=st.sampled_from(sorted(name for name in PROFILES if "table" not in str(PROFILES[name].link))),
    seed=st.integers(0, 2**32),
    forward=impairments,
    topics=st.dictionaries(st.sampled_from(["teleop/forward", "afm/*"]), impairments.filter(bool)),
)
def test_flat_form_gives_the_settings_back(profile, seed, forward, topics):
    link = LinkSettings.of({"profile": profile, "seed": seed, "forward": {**forward, "topics": topics}})
    assert LinkSettings().changed(link.flattened()) == link
    assert LinkSettings().changed(link.flattened(only_set=True)) == link
    for pattern in ("", *topics):
        assert LinkSettings().changed(link.flattened()).forward.block(pattern) == link.forward.block(pattern)


def test_flat_form_holds_only_what_a_message_can_carry():
    flat = LinkSettings.of({"profile": "lte", "forward": {"topics": {"a": {"delay_s": 1.0}}}}).flattened()
    assert {type(value) for value in flat.values()} <= {float, int, str, bool}
    assert flat["forward.topics.a.delay_s"] == 1.0
    assert "forward.topics.a.order" not in flat


def test_examples_of_the_documentation_run():
    text = (REPOSITORY / "docs" / "link.md").read_text(encoding="utf-8")
    (scenario,) = re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)
    assert LinkSettings.of(yaml.safe_load(scenario)["delay_node"]).forward.block("teleop/*").loss.correlation == 0.3
    (code,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    exec(compile(code, "docs/link.md", "exec"), {})


def test_documentation_has_every_profile():
    text = (REPOSITORY / "docs" / "link.md").read_text(encoding="utf-8")
    for name, profile in PROFILES.items():
        assert f"**{name}**" in text, profile.about


def test_what_could_not_be_reported_is_refused():
    many = {f"forward.topics.t{number}.delay_s": 0.1 for number in range(1025)}
    with pytest.raises(ConfigError, match=r"forward has 1025 keys .* at most 1024"):
        LinkSettings().changed(many)
    settings = LinkSettings().changed(dict(list(many.items())[:1024]))
    # each change alone would fit
    with pytest.raises(ConfigError, match="forward has 1025 keys"):
        settings.changed({"forward.delay_s": 0.1})
    with pytest.raises(ConfigError, match="bytes of text, at most 1024 and 262144"):
        LinkSettings().changed({"backward.reliable": ",".join(["x" * 100] * 3000)})
