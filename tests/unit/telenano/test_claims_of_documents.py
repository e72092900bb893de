"""README and docs/laws.md: each sentence that promises something stands beside the tests that would break with it.

A sentence of docs/laws.md that names its tests itself is not listed again. Whoever changes a sentence finds here which
tests it needs; whoever drops a test finds which sentence goes with it.
"""

import cmath
import math
import re
from functools import cache
from pathlib import Path

import pytest

from proto.nodes import LAUNCHER, LINK, START_ORDER, name_of
from services.controller.clamp import NO_LIMIT_N
from services.controller.config import OWN_LAWS, ControllerConfig
from services.controller.laws.passivity import PassivityConfig
from services.delay_node.profiles import PROFILES
from studies.loops.theory import critical_delay_s, loop_model

ROOT = Path(__file__).parents[3]
FORCE_SCALE = 1e8

# the words of the document, as they stand there but for the ends of lines, and the tests: file::function
README: dict[str, tuple[str, ...]] = {
    "they exchange timestamped msgpack messages over ZeroMQ": (
        "test_wire_spec.py::test_command_and_answer_over_sockets",
    ),
    "everything that crosses the bus is recorded": (
        "test_fig12.py::test_nothing_that_must_not_be_lost_is",
        "test_fig12.py::test_every_fast_topic_is_in_the_file",
    ),
    "with a network between them whose every delay is injected on purpose": (
        "test_fig12.py::test_age_of_the_loop_is_of_the_same_tick",
    ),
    "leaves out/fig12/{session.mcap,fig12.png,summary.json}": ("test_fig12.py::test_files_are_there_and_say_the_same",),
    "prints the address of a page to watch it on": (
        "test_page.py::test_the_page_is_a_process_of_the_rig_with_its_address_from_the_beginning_and_over_a_kill",
    ),
    "You need Linux with Python 3.11 or newer": ("test_doctor.py::test_python",),
    "without it a warning says so and the rig runs all the same": (
        "test_runtime_realtime.py::test_what_is_not_permitted_is_reported_once_with_what_to_do",
    ),
    "The tip jumps to the water film at 2.4 nm, is pulled down by the meniscus, and then pushes back": (
        "test_cantilever.py::test_the_meniscus_forms_and_breaks_where_it_should",
        "test_published.py::test_what_the_paper_says_of_its_figure_is_met_by_a_hand_of_the_scenario",
    ),
    "the law balances the two forces; after the hand has let go": (
        "test_virtual_impedance.py::test_steady_state_on_a_spring_is_equation_17",
        "test_fig12.py::test_hold_contact_and_release_are_the_papers",
    ),
    "`summary.json` says, from the recording alone": (
        "test_compose.py::test_recording_of_the_volume_says_the_same_here",
    ),
    "the law's steady state is 1 + 1/K_f | 1.050": ("test_fig12.py::test_hold_contact_and_release_are_the_papers",),
    "0.703 cm, 0.000 nN": ("test_fig12.py::test_hold_contact_and_release_are_the_papers",),
    "whether every hold of the hand became quiet": ("test_holds.py::test_a_session_is_called_by_its_worst_hold",),
    "1000 Hz, 1.0, 0": (
        "test_fig12.py::test_every_fast_topic_is_in_the_file",
        "test_fig12.py::test_nothing_that_must_not_be_lost_is",
    ),
    "The round trip is the delay there and back, half of it each way": (
        "test_studies_simulation.py::test_delay_is_what_was_asked_for_there_and_back_or_one_way",
    ),
    "--round-trip-ms 40 # it rings, and becomes quiet": (
        "test_virtual_fig12.py"
        "::test_forty_milliseconds_round_trip_stay_stable_and_without_the_meniscus_the_contact_is_nearer",
    ),
    "--round-trip-ms 60 # a limit cycle of 7 N at the hand": (
        "test_virtual_fig12.py::test_sixty_milliseconds_round_trip_are_a_limit_cycle",
    ),
    "# three sessions in one figure and one table": (
        "test_sweep.py::test_a_sweep_leaves_a_session_for_each_delay_and_compares_them",
    ),
    "any of six laws can hold the loop": (
        "test_claims_of_documents.py::test_numbers_of_things_are_those_that_there_are",
        "test_studies_lockstep.py::test_every_law_holds_the_hand_against_the_spring",
    ),
    "changed while it runs, from another terminal": (
        "test_running_rig.py::test_link_is_shown_changed_refused_and_cleared",
        "test_running_rig.py::test_switching_the_law_moves_neither_tip_nor_hand",
    ),
    "comes in a package that pip installs, and nothing here is edited": (
        "test_documents_by_letter.py::test_a_law_of_ones_own_is_made_installed_and_run_by_the_letter",
        "test_packages.py::test_the_law_is_listed_and_keeps_the_rules_compiled",
    ),
    "lets a person without a haptic device press the tip with the pointer": (
        "test_view_page.py::test_the_virtual_hand_presses_the_tip_and_the_force_comes_back",
    ),
    "# the same page for a recording": (
        "test_documents_by_letter.py::test_the_page_of_the_recording_of_the_readme_is_served",
        "test_view_recording.py::test_a_recording_plays_and_its_surface_grows",
    ),
    "# … or Foxglove and Lichtblick": (
        "test_foxglove_bridge.py::test_a_viewer_finds_the_channels_and_gets_the_messages",
    ),
    "# … or ROS 2, with the names of CRTK": (
        "test_ros2_bridge.py::test_another_process_of_ros_sees_the_topic_and_reads_the_message",
    ),
    "The delay margin of each law is computed analytically, by offline simulation of the same compiled controllers": (
        "test_studies_theory.py::test_delay_margin_of_the_paper",
        "test_studies_stability.py::test_critical_delays_on_the_spring_are_those_of_theory",
        "test_studies_lockstep.py::test_compiled_and_plain_loop_are_the_same",
    ),
    "and on the running system": ("test_laws_on_the_bus.py::test_bus_agrees_with_lockstep",),
    "all laws on one page": ("test_study_command.py::test_compare_puts_laws_on_one_page",),
    "# which law for my network?": ("test_study_command.py::test_advise_answers_in_sentences_and_leaves_a_page",),
    "95.05 / 45.51 / 22.44": ("test_studies_readme.py::test_the_critical_delays_of_theory_are_those_of_the_readme",),
    "95.05 / 45.51 / 22.45 | 96.3 / 45.0 / 22.5": (
        "test_studies_stability.py::test_critical_delays_on_the_spring_are_those_of_theory",
        "test_laws_on_the_bus.py::test_bus_agrees_with_lockstep",
    ),
    "none up to 500 | hold the contact at 200": (
        "test_studies_readme.py::test_laws_without_a_critical_delay_hold_the_springs_up_to_half_a_second",
        "test_laws_on_the_bus.py::test_bus_agrees_with_lockstep",
    ),
    "with the force clamp of the slave off and on, with a hand of constant force and with passive arms": (
        "test_studies_advice.py::test_the_page_runs_what_the_advice_runs",
    ),
    "On a stiff wall `model_mediated` with its clamp holds over every network that was tried": (
        "test_studies_readme.py::test_laws_that_the_readme_recommends_hold_over_its_networks",
    ),
    "`smith` can be taken as well up to 120 ms": (
        "test_studies_readme.py::test_laws_that_the_readme_recommends_hold_over_its_networks",
    ),
    "gives the exact force where the delay is constant, at the price of heavy free motion": (
        "test_studies_readme.py::test_laws_that_the_readme_recommends_hold_over_its_networks",
        "test_studies_readme.py::test_the_price_of_the_damping_is_that_of_the_document",
    ),
    "It survives a `kill -9`": (
        "test_running_rig.py::test_killed_recorders_leave_files_that_lack_no_more_than_a_flush",
    ),
    "replays through the bus instead of any node": (
        "test_documents_by_letter.py::test_the_hand_of_a_recording_is_replayed_into_the_rig_that_the_readme_names",
    ),
    "re-runs a node, the link included, bit by bit": (
        "test_virtual_rig.py::test_a_rerun_gives_the_same_bits",
        "test_fig12.py::test_each_node_is_rerun_bit_by_bit_on_the_machine_that_recorded_it",
        "test_rerun.py::test_there_is_a_reference_for_each_law_and_for_the_link",
    ),
    "--to mcap-json --out fig12-json.mcap": (
        "test_recording_export.py::test_the_json_recording_is_read_by_the_reference_reader",
    ),
    "# one container a node, then the table in the log of `session`": (
        "test_compose.py::test_summary_and_nodes_are_in_the_logs",
    ),
    "on two machines with a real network between them, encrypted, with keys of your own": (
        "test_two_sites.py::test_the_new_session_is_the_experiment_and_nobody_can_read_it",
        "test_two_sites.py::test_who_is_not_known_receives_nothing",
    ),
    "with a trial of the two sites on one machine": (
        "test_documents_by_letter.py::test_two_sites_of_the_readme_run_on_one_machine_as_the_page_of_deployment_says",
    ),
    "has a table of the faults that were injected": ("test_ledger.py::test_the_page_has_every_fault_and_its_promise",),
    "One function judges recordings, maps and validation alike": (
        "test_claims_of_documents.py::test_one_function_judges",
    ),
    "it fits the growth rates of the motion of α_f F_s, with their standard errors": (
        "test_verdict.py::test_growth_rate_is_the_real_part_of_the_mode",
        "test_verdict.py::test_what_noise_hides_is_never_called_steady_growth",
    ),
    "the motion of every hold dies out and the tip presses with the hand's force to a tenth": (
        "test_verdict.py::test_the_force_has_to_be_the_hands_to_a_tenth",
        "test_holds.py::test_a_swing_that_dies_out_grows_or_goes_on",
    ),
    "The holds, and the reason in words, are in `summary.json`": (
        "test_summary.py::test_every_summary_has_the_keys_of_the_page_and_each_of_them_is_met",
    ),
    "The rig is seven processes with one PUB socket each (the link has one at each site) and no broker": (
        "test_claims_of_documents.py::test_numbers_of_things_are_those_that_there_are",
        "test_nodes.py::test_the_page_is_beside_the_rig",
    ),
    "The haptic node runs at 1 kHz on absolute deadlines": (
        "test_runtime_deadlines.py::test_a_loop_on_time_keeps_exactly_to_the_grid",
    ),
    "so no hop adds half a sample of latency": (
        "test_runtime_node.py::test_a_node_without_deadline_acts_on_messages_at_once",
        "test_fig12.py::test_age_of_the_loop_is_of_the_same_tick",
    ),
    "without a command for 50 ms the AFM holds and then retracts, and the hand goes to zero force": (
        "test_chaos.py::test_afm_without_commands_holds_then_retracts_and_stays",
        "test_chaos.py::test_hand_goes_to_zero_force",
    ),
    "# everything stops, until `telenano session arm`": (
        "test_running_rig.py::test_an_emergency_stop_needs_no_turn_and_is_recorded",
    ),
    "# how a running rig is doing, node by node": ("test_status_command.py::test_a_rig_in_words",),
    "# whether this machine is fit to run one, and what to do": ("test_doctor.py::test_every_check_is_made_here",),
    "[every equation and where it is](docs/paper.md)": (
        "test_paper_documents.py::test_every_equation_that_the_code_cites_is_in_the_map",
    ),
    "[docs/cli.md](docs/cli.md) has all commands": (
        "test_app.py::test_every_command_and_flag_is_documented_and_no_other",
    ),
    "`make site` builds them as a site": ("test_paper_documents.py::test_the_site_has_every_page",),
    "steps and small numerical tools that give the same bits on every processor": (
        "test_rerun.py::test_another_processor_gives_the_same",
    ),
}
LAWS: dict[str, tuple[str, ...]] = {
    "So every law ends in a position reference on both sides": (
        "test_laws.py::test_the_law_keeps_the_rules_that_the_rig_relies_on",
    ),
    "The product F v at that scale is the same power on both sides": (
        "test_studies_lockstep.py::test_energies_are_the_work_at_the_device_and_at_the_base",
    ),
    "So nothing is assumed about the sample, and a gap in the link is no gap of that loop": (
        "test_controller_node.py::test_local_loop_goes_on_with_the_instruments_own_steps",
    ),
    "It is as many whole periods, three at most, as the half is behind the hand": (
        "test_paced.py::test_what_it_is_behind_is_made_up_for_a_few_periods_at_a_time",
    ),
    "discretised exactly for forces held over a period": (
        "test_discretisation.py::test_it_is_the_matrix_exponential",
        "test_virtual_impedance.py::test_free_motion_is_the_closed_form_of_the_impedance",
    ),
    "A value outside it is refused, and the error names the range": (
        "test_corners.py::test_a_setting_beyond_its_range_is_refused_with_the_range",
    ),
    "`controller.switch_limit_s` (2) is the longest wait when the law changes": (
        "test_law_switch.py::test_half_that_waits_too_long_lets_the_hand_go",
    ),
    "With `controller.clamp` the tip presses no harder than the hand does, by the last signal, plus a margin": (
        "test_clamp.py::test_towards_the_sample_it_lets_through_what_the_hand_presses_more",
    ),
    "`passivity` and `model_mediated` have the clamp, the others do not": (
        "test_claims_of_documents.py::test_two_laws_come_with_the_clamp",
        "test_clamp.py::test_every_law_has_one_clamp_at_most",
    ),
    "x_sr = α_p x. With K_v = 0 it rests where F_m = α_f F_s (1 + 1/K_f)": (
        "test_virtual_impedance.py::test_reference_is_the_scaled_position",
        "test_virtual_impedance.py::test_steady_state_on_a_spring_is_equation_17",
    ),
    "It bears nearly the same delay as the paper's law, within a few percent": (
        "test_claims_of_documents.py::test_direct_reflection_bears_nearly_the_delay_of_the_papers_law",
    ),
    "cut to the energy that is left": ("test_wave.py::test_wave_that_claims_a_millionth_more_way_than_energy_is_cut",),
    "B_v = b terminates the line at the master with its own impedance": (
        "test_wave.py::test_resumed_line_starts_without_a_wave",
        "test_studies_theory.py::test_scattering_of_the_wave_line_is_the_pure_delay",
    ),
    "wave filter, drift compensation, and passivity in one": (
        "test_wave.py::test_filter_is_the_first_order_low_pass",
        "test_wave.py::test_even_wave_over_a_constant_delay_is_at_the_bound",
        "test_studies_promises.py::test_waves_keep_hand_and_tip_together_over_a_link_with_jitter",
    ),
    "For the line this is v = 0, which reflects all waves, u = −w, and the line goes on": (
        "test_wave.py::test_hand_whose_device_is_off_for_a_moment_keeps_what_is_on_its_way",
    ),
    "up to 375 N s/m on a stiff sample at 300 ms and 0.5 Hz": (
        "test_claims_of_documents.py::test_what_a_delayed_spring_takes_from_the_hand",
    ),
    "Each holds 5 mJ at most, and 1 mJ as a rule": (
        "test_passivity.py::test_account_takes_growing_counters_only_and_caps_its_store",
        "test_laws_document.py::test_defaults_in_the_tables_are_those_of_the_settings",
    ),
    "A sample stiffer than 800 N/m is beyond the local loop": (
        "test_local_loops.py::test_a_half_bears_samples_up_to_its_stated_stiffness_and_swings_just_beyond",
    ),
    "The motion is cut to what the store pays for, |F d′| = S": (
        "test_passivity.py::test_motion_at_the_bound_passes_and_a_millionth_past_it_is_cut",
    ),
    "Motion that is cut at the slave remains due, and is made up when there is energy": (
        "test_passivity.py::test_cut_stretch_holds_exactly_the_energy_left",
    ),
    "At the master, motion that the operator makes by himself is never cut": (
        "test_passivity.py::test_operator_who_pulls_back_himself_is_not_held",
    ),
    "The model moves towards the fit no faster than a limit on the force allows": (
        "test_model_mediated.py::test_update_at_the_bound_passes_and_a_millionth_past_it_does_not",
        "test_model_mediated.py::test_update_never_uses_more_energy_than_there_is",
    ),
    "A surface that is detected late begins under the hand, without force": (
        "test_model_mediated.py::test_surface_met_late_begins_under_the_hand_almost_without_force",
    ),
    "towards the sample at (F_m + F_0 − F_s)/B_g at most": (
        "test_model_mediated.py::test_guard_presses_no_harder_than_the_hand",
        "test_model_mediated.py::test_guard_takes_long_gaps_without_pressing_through",
    ),
    "The hand moves nothing, so there is no loop": (
        "test_studies_presets.py::test_a_law_that_moves_no_tip_is_said_to_have_lost_contact",
        "test_afm_tactile.py::test_the_hand_is_moved_like_the_surface_at_a_millimetre_a_nanometre",
    ),
    "Each line of the two halves leaves S_m + S_s + V + Φ + Σ outflow unchanged or lowers it": (
        "test_passivity.py::test_channel_is_passive_whatever_hand_tip_and_link_do",
    ),
    "A draw of |u| ≤ 2 D/U has u²/2 Ts ≤ D": (
        "test_wave.py::test_wave_that_claims_a_millionth_more_way_than_energy_is_cut",
    ),
    "A simulated tip is felt through its cantilever, so its k counts": (
        "test_local_loops.py::test_the_base_meets_nothing_stiffer_than_its_spring_or_its_cantilever",
    ),
    "The dead band works in front of any law, in both directions": (
        "test_deadband.py::test_first_signal_and_every_one_without_the_band_pass",
        "test_law_switch.py::test_dead_band_saves_messages_and_the_loop_lives",
    ),
    "Each side reports itself disengaged in the new law and ignores packets of the old one": (
        "test_controller_node.py::test_signal_of_another_law_counts_as_silence",
    ),
    "it takes over from where the hand is, with its speed": (
        "test_law_switch.py::test_switch_in_motion_keeps_the_speed_and_comes_to_rest",
    ),
    "the pair couples by itself when the other half follows": (
        "test_law_switch.py::test_slave_that_changes_first_stands_until_the_master_follows",
    ),
    "Each half states what it may still spend and what its controller has dissipated": (
        "test_law_switch.py::test_status_reports_energy_passivity_and_round_trip",
    ),
    "The master half therefore goes on sending and stays active, and so does the slave half": (
        "test_wave.py::test_hand_whose_device_is_off_for_a_moment_keeps_what_is_on_its_way",
    ),
    "Only after the silence limit of the law (0.5 s) is the line let down": (
        "test_wave.py::test_line_of_a_hand_that_stays_off_is_let_down_after_the_silence_limit",
    ),
    "The master half neither steps nor sends for a sample that a device calls `stale`": (
        "test_controller_node.py::test_sample_that_is_repeated_is_none",
    ),
    "A hand that is `lost` is silence for a second, in which the tip holds and is withdrawn": (
        "test_virtual_coupled_device.py"
        "::test_tip_of_a_hand_that_is_lost_holds_and_is_withdrawn_as_after_the_death_of_its_node",
    ),
}


@cache
def functions() -> frozenset[str]:
    """Return file::name of every test function."""
    return frozenset(
        f"{path.name}::{name}"
        for path in (ROOT / "tests").rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)\(", path.read_text(encoding="utf-8"), re.MULTILINE)
    )


def flat(document: str) -> str:
    return " ".join((ROOT / document).read_text(encoding="utf-8").split())


@pytest.mark.parametrize(("document", "claims"), [("README.md", README), ("docs/laws.md", LAWS)])
def test_every_claim_stands_in_its_document_and_has_tests_that_exist(
    document: str, claims: dict[str, tuple[str, ...]]
) -> None:
    text = flat(document)
    assert [claim for claim in claims if claim not in text] == []
    assert [claim for claim, tests in claims.items() if not tests] == []
    assert [test for tests in claims.values() for test in tests if test not in functions()] == []


def test_numbers_of_things_are_those_that_there_are() -> None:
    assert len(OWN_LAWS) == 6
    assert len({*START_ORDER, LAUNCHER}) == 7
    assert [node for node in START_ORDER if name_of(node) == LINK] == ["delay_node@master"]
    networks = re.search(r"(\d+) networks are ready, most of them from published measurements", flat("docs/howto.md"))
    assert networks is not None
    assert int(networks[1]) == len(PROFILES)
    assert 2 * sum(bool(profile.source) for profile in PROFILES.values()) > len(PROFILES)


def test_two_laws_come_with_the_clamp() -> None:
    """A clamp of the law's own counts as on while its margin is one that a hand can meet."""
    margins = {name: getattr(ControllerConfig(law=name).params(), "margin_n", NO_LIMIT_N) for name in OWN_LAWS}
    waves = ControllerConfig(law="wave").params()
    assert {name for name, margin in margins.items() if margin < NO_LIMIT_N} - {"wave"} == {
        "passivity",
        "model_mediated",
    }
    assert not waves.clamped


def test_direct_reflection_bears_nearly_the_delay_of_the_papers_law() -> None:
    for stiffness in (10.0, 20.0, 38.0):
        loops = [loop_model(law, OWN_LAWS[law].config(), stiffness) for law in ("virtual_impedance", "position_force")]
        papers, direct = (critical_delay_s(loop) for loop in loops if loop is not None)
        assert direct == pytest.approx(papers, rel=0.06, abs=0.0)


def test_what_a_delayed_spring_takes_from_the_hand() -> None:
    """A spring K behind a round trip T has Re Z = -K sin(omega T) / omega; the coupling K_c is in series with it."""
    coupling, omega, round_trip_s = PassivityConfig().coupling_stiffness_n_per_m, 2.0 * math.pi * 0.5, 0.3
    stiff = 1.0 / (1.0 / coupling + 1.0 / (1.5e-6 * FORCE_SCALE * 400.0))
    z = stiff * cmath.exp(-1j * omega * round_trip_s) / (1j * omega)
    assert z.real == pytest.approx(-stiff * math.sin(omega * round_trip_s) / omega, rel=1e-12)
    assert -z.real == pytest.approx(375.0, rel=0.01)


def test_one_function_judges() -> None:
    """Whoever gives a verdict calls `analysis.verdict.judge`, and nobody else defines one."""
    found: dict[str, set[str]] = {r"^def judge\(": set(), r"^from analysis\.verdict import .*\bjudge\b": set()}
    for folder in ("analysis", "studies", "services", "telenano"):
        for path in (ROOT / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            for pattern, places in found.items():
                if re.search(pattern, text, re.MULTILINE):
                    places.add(str(path.relative_to(ROOT)))
    definitions, callers = found.values()
    assert definitions == {"analysis/verdict.py"}
    assert callers == {"analysis/holds.py", "studies/loops/cells.py"}
