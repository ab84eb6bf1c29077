"""The contract, rule by rule: the names that version 1 never loses, and for every other rule the tests that hold it."""

from __future__ import annotations

import ast
import json
from functools import cache
from typing import Any

import pytest

from tests.support.source_texts import PROJECT

RULES = {
    "one key has one type and one meaning wherever it occurs": [
        "api/openapi/test_keys.py::test_one_key_has_one_shape_wherever_it_occurs",
        "api/openapi/test_keys.py::test_one_key_has_one_schema_or_one_that_adds_to_it",
    ],
    "numbers have the digits that their uncertainty supports": [
        "api/resources/test_measurements.py::test_numbers_have_the_digits_that_their_uncertainty_supports",
        "analyses/documents/test_numbers.py::test_no_number_is_longer_than_its_use_supports_and_none_too_short",
    ],
    "every 4xx and 5xx is a problem document with code and advice": [
        "api/openapi/test_operations.py::test_every_problem_is_declared_as_one",
        "api/refusals/test_bad_addresses.py::test_unknown_addresses_and_methods_are_problems",
        "api/refusals/test_bad_input.py::test_every_missing_field_is_named",
    ],
    "401, 403 and 404 come before what is wrong with the content": [
        "api/access/test_authentication.py::test_a_missing_or_wrong_key_is_401_whatever_else_is_wrong",
        "api/refusals/test_bad_addresses.py::test_an_unknown_id_is_not_found_before_the_body_is_looked_at",
    ],
    "an empty upload is said before a hash that does not match": [
        "api/uploads/test_refused.py::test_an_empty_upload_is_said_to_be_empty_before_its_hash_is_wrong",
    ],
    "scopes open what the contract says and nothing else": [
        "api/access/test_scopes.py::test_every_route_is_open_to_its_scopes_alone",
        "api/access/test_scopes.py::test_an_ingest_key_sends_images_and_reads_nothing",
    ],
    "a key that is limited to sessions finds nothing of others": [
        "api/access/test_scopes.py::test_a_limited_key_finds_nothing_of_other_sessions_on_any_route",
    ],
    "without keys the service listens on loopback alone, for its own pages": [
        "api/access/test_authentication.py::test_a_service_without_keys_must_listen_on_loopback_only",
        "api/access/test_origins.py::test_every_route_refuses_a_foreign_host_and_a_foreign_origin",
    ],
    "unknown fields and parameters, wrong types and over-long values are 422": [
        "api/refusals/test_bad_addresses.py::test_a_query_parameter_that_the_route_lacks_is_refused",
        "api/refusals/test_bad_input.py::test_a_wrong_field_is_named",
        "api/refusals/test_bad_input.py::test_an_overflowing_number_is_refused",
    ],
    "bodies have a largest size, and large ones hold up nobody": [
        "api/refusals/test_bad_input.py::test_a_body_over_its_limit_is_refused",
        "api/test_large_bodies.py::test_the_event_loop_goes_on_while_a_large_body_is_read",
    ],
    "values in a wrong unit are refused with the guess": [
        "api/representations/test_units.py::test_a_pitch_in_metres_is_refused",
        "api/representations/test_units.py::test_a_robot_in_radians_or_metres_is_refused",
        "api/representations/test_units.py::test_commanded_poses_in_metres_or_radians_are_refused",
        "api/representations/test_units.py::test_a_camera_in_other_units_is_refused",
    ],
    "lists go from oldest to newest by pages of 50": [
        "api/resources/test_lists.py::test_lists_run_from_oldest_to_newest_by_pages",
        "api/resources/test_lists.py::test_a_list_gives_fifty_items_unless_asked_otherwise",
    ],
    "what is sent in bulk is stored whole or not at all": [
        "api/resources/test_resources.py::test_bulk_poses_are_all_or_nothing",
    ],
    "gzip is honoured": [
        "api/representations/test_compression.py::test_the_service_compresses_lists_and_answers_tags_of_either_form",
    ],
    "analyses and lists are CSV tables where these are preferred": [
        "api/representations/test_preferences.py::test_csv_is_for_those_who_prefer_it",
        "api/representations/test_csv_lists.py::test_every_list_is_a_table_too",
        "api/representations/test_csv_lists.py::test_a_list_is_answered_as_a_table_that_can_be_sent_again",
    ],
    "an analysis has an entity tag over its inputs and the build": [
        "analyses/cameras/test_intrinsics.py::test_an_answer_the_client_has_is_not_sent_again",
    ],
    "everything is described, and has an example from a run": [
        "api/openapi/test_openapi.py::test_everything_is_described",
        "api/test_examples.py::test_every_body_but_images_has_an_example",
        "api/test_examples.py::test_every_example_is_what_its_schema_says",
    ],
    "enumerations are named once, bounds are those of JSON Schema, and nothing but X or null is a union": [
        "api/openapi/test_openapi.py::test_enumerations_are_named_once_and_referred_to",
        "api/openapi/test_openapi.py::test_bounds_are_those_of_json_schema",
        "api/openapi/test_openapi.py::test_the_only_union_is_something_or_null",
    ],
    "every code is in docs/errors.md with cause and remedy": [
        "../packaging/test_errors_document.py::test_every_code_is_in_the_document",
        "../packaging/test_errors_document.py::test_every_warning_is_in_the_document",
    ],
    "an upload is answered after it is durable, and the same one again by the first": [
        "api/uploads/test_accepted.py::test_a_raw_upload_is_kept_with_its_metadata",
        "api/uploads/test_accepted.py::test_the_same_upload_again_gives_the_first_measurement",
        "api/uploads/test_storage.py::test_an_upload_that_fails_at_any_step_leaves_no_file",
    ],
    "files are refused by their headers, before they are kept": [
        "api/uploads/test_refused.py::test_another_format_is_refused",
        "api/uploads/test_refused.py::test_a_bomb_is_refused_by_its_header",
        "api/uploads/test_refused.py::test_an_upload_over_the_limit_is_refused",
    ],
    "a full disk refuses uploads and nothing else": [
        "api/uploads/test_storage.py::test_a_full_disk_refuses_uploads_and_nothing_else",
    ],
    "missing images are asked for by target": [
        "api/uploads/test_accepted.py::test_missing_is_what_has_no_measurement_of_its_target",
    ],
    "measurements can be corrected, excluded and deleted; each is in the audit trail": [
        "api/resources/test_corrections.py::test_what_belongs_to_the_image_changes_in_all_its_measurements",
        "api/resources/test_corrections.py::test_an_exclusion_is_of_one_measurement_and_can_be_undone",
        "api/resources/test_corrections.py::test_the_audit_trail_names_all_that_changed",
        "api/resources/test_deletions.py::test_measured_poses_go_all_or_by_pose_and_cycle",
    ],
    "targets and robots go when nothing refers to them": [
        "api/resources/test_deletions.py::test_a_target_goes_when_no_session_looks_at_it",
        "api/resources/test_deletions.py::test_a_robot_goes_when_no_session_names_it",
    ],
    "every image has an overlay and a thumbnail, refused ones too": [
        "api/test_drawings.py::test_every_refused_image_has_an_overlay_and_a_thumbnail",
    ],
    "a report is immutable and verifies from what it was made from": [
        "api/test_reports.py::test_a_finished_report_cannot_be_changed_by_anyone",
        "api/test_reports.py::test_a_report_is_computed_from_what_it_was_made_from_until_grid_points_are_deleted",
    ],
    "the dashboard is where `/` leads": [
        "web/test_pages.py::test_the_services_address_leads_to_a_page_for_people",
    ],
}

FIELDS = {
    "TargetRead": "id name kind columns rows pitch_mm marker_mm dictionary legacy_layout pitch_standard_uncertainty_mm "
    "certificate created_at",
    "RobotRead": "id name manufacturer model serial_number joints joint_coupling datasheet_repeatability_mm "
    "datasheet_accuracy_mm",
    "SessionRead": "id name target_ids robot_id lens intrinsics conditions created_at counts",
    "PoseRead": "pose_id position_mm roll_deg pitch_deg yaw_deg joint_angles_deg approach",
    "MeasurementRead": "id session_id pose_id cycle burst target_id siblings focus_group joint_angles_deg captured_at "
    "received_at finished_at sha256 filename bytes status attempts duration_ms excluded labelling capture_quality "
    "failure calibration points",
    "CalibrationRead": "estimator initialisation grade image_width_px image_height_px intrinsics distortion "
    "standard_uncertainty interval_95 T_camera_target pose reprojection observability warnings",
    "ReprojectionRead": "rms_px mean_px std_px max_px points rejected",
    "ObservabilityRead": "focal_relative_uncertainty condition_number tilt_deg prior_dominated "
    "ambiguity_log_likelihood_ratio",
    "MeasuredPoseRead": "pose_id cycle joint_angles_deg position_mm rotation covariance",
    "RepeatabilityAnalysis": "subject inputs_sha256 core_version pending excluded warnings poses steadiness drift "
    "distances approach_variation acceptance budget",
    "IntrinsicsAnalysis": "subject inputs_sha256 core_version pending excluded warnings groups target_transforms "
    "target_shape",
    "DhAnalysis": "subject inputs_sha256 core_version pending excluded warnings joints method_agreement region "
    "null_space validation error_model",
}


@cache
def names_of(path: str) -> frozenset[str]:
    tree = ast.parse((PROJECT / "tests" / "app" / path).read_text(encoding="utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


@pytest.mark.parametrize("rule", RULES)
def test_a_rule_is_held_by_tests_that_exist(rule: str) -> None:
    for place in RULES[rule]:
        path, _, name = place.partition("::")
        assert name in names_of(path), place


@pytest.mark.parametrize("schema", FIELDS)
def test_version_1_never_loses_a_field(schema: str) -> None:
    contract: dict[str, Any] = json.loads((PROJECT / "openapi.json").read_text(encoding="utf-8"))
    properties = contract["components"]["schemas"][schema]["properties"]
    assert not set(FIELDS[schema].split()) - properties.keys()
