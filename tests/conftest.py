"""For all tests: the same random examples each time, and no working directory to lean on."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

# The examples follow from the test's own code alone; none is kept from run to run, none depends on the clock.
settings.register_profile("exunet", derandomize=True, database=None, deadline=None)
settings.load_profile("exunet")

# A shell starts background jobs with Ctrl-C ignored, which every process that a test starts would inherit.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def outside_of_the_project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Run in an empty folder, whatever the tests were started from, and leave nothing in it.

    A test that finds its files only from the project's root, or writes into the working directory, fails.
    """
    folder = tmp_path_factory.mktemp("working_directory")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield
    assert list(folder.iterdir()) == []


# The same physics in the compiled loop and in the fused net, by file, or by file and test: slow tests that
# .ci/run runs. The quick ones try it with connectors in Exudyn's loop.
OTHER_FORMS = (
    "test_bounce.py", "test_forces_on_bodies.py", "test_guides.py", "test_inputs_and_states.py",
    "test_sleeping.py", "test_thrust.py", "test_attachments.py", "test_effects_on_bodies.py",
    "test_tethers.py", "test_reels.py", "test_reel_instants.py", "test_barrels.py", "test_ejection.py",
    "closing/test_closing_line.py",
    "test_effects.py::test_a_snap_that_breaks", "test_simulation.py::test_a_body_is_read",
    "test_simulation.py::test_a_force_on_a_node_that_is_held", "test_simulation.py::test_reset_forgets",
    "test_simulation.py::test_a_force_changes", "test_simulation.py::test_forces_on_several_points",
)  # fmt: skip

# These take seconds each and have no quicker sibling: slow tests that .ci/run runs.
TAKE_LONG = (
    "test_folding.py::test_any_net_fits_or_is_told_what_would",
    "test_folding.py::test_lengths_canister_and_determinism[4-star",
    "test_folding.py::test_how_far_cut_nets_fold[octagon-12-1",
    "test_shapes.py::test_a_satellite_of_four_solids_turns_alike_in_both_codes",
    "test_schema.py::test_schema_and_reader_agree_on_every_pair_of_effects",
    "test_casefile.py::test_any_value_is_read_or_refused",
    "test_fmu_variables.py::test_the_same_case_gives_the_same_file_another_one_another_token",
    "test_fuzz.py::test_forty_random_scenes",
    "test_resume.py::test_a_resumed_run_has_the_moved_starts_of_the_run[9-0-0",
    "test_expected_cost.py::test_the_reference_takes_what_is_told[nets/cut",
    "test_effects.py::test_a_snap_that_breaks_loses_what_the_cable_held[stepping0-connectors",
    "test_effects.py::test_both_codes_agree[molecular_drag",
    "test_verify_answers.py::test_both_codes_give_the_known_answer[wave_small_stretch",
    "reference/test_ref_contact.py::test_the_way_to_a_stop",
    "reference/test_ref_contact.py::test_what_a_driven_body_gives[prescribed",
    "reference/test_ref_reels.py::test_locked_is_a_tether_of_that_length[none",
    "reference/test_ref_j2.py::test_energy_balances_in_a_strong_field",
    "reference/test_ref_effects.py::test_books_close_with_everything_at_once[RK45-in orbit",
    "reference/test_ref_bodies.py::test_full_inertia_keeps_its_books_over_ten_turns",
    "reference/test_ref_bodies.py::test_order_2_of_verlet_and_energy_momentum",
    "reference/test_ref_thrust.py::test_free_bullets_follow_the_integrals[Verlet",
    "reference/test_ref_drag.py::test_energy_balances[RK4-air_drag",
    "reference/test_ref_launch_body.py::test_a_bullet_that_has_left_is_not_pushed_again[Verlet-spring",
    "reference/test_ref_eject.py::test_a_barrel_of_the_body_pushes_from_the_ejection_on",
    "reference/test_ref_breaking.py::test_cooling_net_keeps_its_energy[RK4",
)

# Variants that take seconds each; a quicker one of the same test stays among the quick tests, so .ci/run
# leaves these out.
TAKES_SECONDS = (
    "reference/test_ref_contact.py::test_a_bullet_leaves_with_the_restitution[0.9",
    "reference/test_ref_contact.py::test_a_bullet_leaves_with_the_restitution[0.2",
    "reference/test_ref_contact.py::test_what_a_free_box_gets[regularised",
    "reference/test_ref_contact.py::test_what_a_driven_body_gives[fixed",
    "reference/test_ref_launch_body.py::test_a_bullet_that_has_left_is_not_pushed_again[DOP853",
    "reference/test_ref_launch_body.py::test_a_bullet_that_has_left_is_not_pushed_again[RK4",
    "reference/test_ref_launch_body.py::test_a_bullet_that_has_left_is_not_pushed_again[Verlet-gas",
    "reference/test_ref_launch_force.py::test_books_close_and_momentum_counts_the_chaser[RK4",
    "reference/test_ref_launch_force.py::test_bullets_that_come_back_are_pushed_again[RK4",
    "reference/test_ref_thrust.py::test_work_put_in_is_negative_dissipation[DOP853",
    "reference/test_ref_thrust.py::test_work_put_in_is_negative_dissipation[RK",
    "reference/test_ref_effects.py::test_books_close_with_everything_at_once[DOP853",
    "reference/test_ref_effects.py::test_books_close_with_everything_at_once[RK45-on the ground",
    "reference/test_ref_reels.py::test_locked_is_a_tether_of_that_length[lock",
    "reference/test_ref_implicit.py::test_order_is_2[EM",
    "test_cost.py::test_the_error_of_the_energy_is_the_same_in_flight[reference",
    "test_resume.py::test_the_command_finishes_what_was_cut_short",
    "test_thrust.py::test_thrust_gives_its_impulse_and_its_work_is_booked[RK44",
    "test_thrust.py::test_thrust_gives_its_impulse_and_its_work_is_booked[VelocityVerlet",
    "test_reels.py::test_nodes_go_on_and_come_off[solver={method='DOPRI5', tolerance=1e-9}",
    "test_verify_answers.py::test_both_codes_give_the_known_answer[wave_large",
    "test_retry.py::test_a_retry_mends_what_coarse_steps_spoil[engine0",
    "test_result.py::test_a_file_that_cannot_grow_is_one_line_and_no_file[0.3",
    "test_result.py::test_a_file_that_cannot_grow_is_one_line_and_no_file[0.01",
    "test_fuzz.py::test_what_failed_once[at_rest_in_orbit",
    "test_bodies.py::test_a_free_body_turns_as_jacobis_functions_say[compiled",
    "test_cost.py::test_the_energy_is_that_of_every_block[point mass",
    "test_forces_on_bodies.py::test_energy_and_momenta_are_kept[fused",
    "test_effects_on_bodies.py::test_a_body_in_orbit_moves_as_a_particle[two_body",
    "test_barrels.py::test_a_guided_chaser_gives_what_the_bullets_get[fixed-fused",
    "test_attachments.py::test_momentum_and_energy_are_kept[fused-guided-kept",
    "test_fuzz.py::test_what_failed_once[jump_far_ahead",
    "test_auto.py::test_the_promised_accuracy_is_met[damped",
    "test_told_plainly.py::test_what_is_printed_fits_80_columns[arguments3",
    "test_figures_print.py::test_pages_are_legible[(170.0, 80",
    "test_figures_print.py::test_pages_are_legible[(85.0, 85",
    "test_figures_bodies.py::test_snapshots_are_legible[thrown-(170",
    "test_figures_bodies.py::test_every_axis_has_at_least_two_round_numbers[True",
    "test_resume.py::test_a_resumed_run_has_the_moved_starts_of_the_run[0-None",
    "test_resume.py::test_a_resumed_run_has_the_moved_starts_of_the_run[9-None",
    "test_cli.py::test_a_pipe_that_closes_early_ends_a_command_quietly[arguments2",
    "test_told_plainly.py::test_what_is_printed_fits_80_columns[arguments2",
    "reference/test_ref_implicit.py::test_hard_starts_run[DOP853-fast",
    "reference/test_ref_implicit.py::test_small_and_degenerate_nets_run[{'method': 'RK4'",
    "contact/test_touch.py::test_damped_forces_and_their_power[box and lying cylinder",
    "contact/test_touch.py::test_integrals_are_those_of_adaptive_quadrature[box and lying cylinder",
    "contact/test_touch.py::test_forces_have_no_jump_along_a_way[over a tip",
    "contact/test_touch.py::test_spans_are_where_the_distance_is_less[frustum",
    "contact/test_touch.py::test_spans_are_where_the_distance_is_less[widening frustum",
    "test_figures_print.py::test_pages_are_legible[(170.0, 120",
    "test_planar.py::test_area_at_1_75_s_with_both_readings_of_the_packing[planar_deployment.toml-0.78",
    "test_reels.py::test_a_script_commands_as_a_case_does[connectors",
    "test_effects_together.py::test_energy_balances_with_some_effects[connectors-1",
    "reference/test_ref_tethers.py::test_an_off_centre_snap_keeps_momentum_angular_momentum_and_energy[Verlet",
    "reference/test_ref_tethers.py::test_an_off_centre_snap_keeps_momentum_angular_momentum_and_energy[DOP853",
    "reference/test_ref_implicit.py::test_hard_starts_run[DOP853-overstretched",
    "reference/test_ref_contact.py::test_it_slides_above_the_friction_angle[options0",
    "reference/test_ref_launch_force.py::test_books_close_and_momentum_counts_the_chaser[DOP853-spring",
    "test_result.py::test_a_file_that_cannot_grow_is_one_line_and_no_file[0.99999",
    "test_result.py::test_a_file_that_cannot_grow_is_one_line_and_no_file[0.9",
    "test_verify_answers.py::test_both_codes_give_the_known_answer[hanging-hanging",
)


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        name = item.nodeid.removeprefix("tests/")
        form = name.partition("[")[2]
        another_form = ("compiled" in form or "fused" in form) and name.startswith(OTHER_FORMS)
        if another_form or name.startswith(TAKE_LONG):
            item.add_marker(pytest.mark.slow)
            item.add_marker(pytest.mark.ci)
        elif name.startswith(TAKES_SECONDS):
            item.add_marker(pytest.mark.slow)
