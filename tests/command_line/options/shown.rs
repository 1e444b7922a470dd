//! Tests that show the effect of each option and feature.

/// Options by first name (prefix `1.0:` or `1.1:` if specific to a version), and tests.
pub const OPTIONS: &[(&str, &[&str])] = &[
    (
        "I O",
        &[
            "the_line_of_version_1_0_with_folders_of_windows",
            "the_lines_of_version_1_1_with_a_pof",
            "lines/commands",
        ],
    ),
    (
        "mem",
        &[
            "memory_in_flight_stays_within_its_bound",
            "ten_times_the_file_takes_no_more_memory",
            "the_example_of_a_file_of_options",
        ],
    ),
    ("N", &["threads_queues_and_repetition_change_no_byte", "threads_of_the_command_line_are_the_jobs"]),
    ("q", &["lines/outputs", "quiet_prints_nothing_and_files_are_the_same_again"]),
    ("progress", &["lines/outputs", "a_bar_is_for_terminals"]),
    ("i", &["lines/inputs_and_versions", "patterns_give_files_in_order_each_once"]),
    ("o", &["lines/outputs", "a_star_is_the_stem_of_the_input"]),
    ("oext", &["attributes_can_be_left_out", "the_line_that_writes_nothing"]),
    ("ounc", &["attributes_can_be_left_out", "the_line_of_version_1_0_with_folders_of_windows"]),
    ("nil", &["the_line_that_writes_nothing", "lines_of_version_1_1"]),
    ("log 1.0:olog", &["lines/outputs", "a_run_names_all_that_it_wrote_by_short_paths"]),
    (
        "log_flush clear_log clear_log_history",
        &["every_option_leaves_its_mark_in_the_job", "a_line_that_asks_for_information_gets_it"],
    ),
    ("1.0:ostat", &["both_layouts_of_line_statistics_keep_the_laws", "lines_of_version_1_0"]),
    ("otraj", &["sensor_path_from_origins_equals_that_from_beams", "with_a_trajectory_rows_are_its_poses"]),
    (
        "h 1.0:? v",
        &[
            "a_line_that_asks_for_information_gets_it",
            "information_is_asked_for_in_the_same_words_in_both_versions",
        ],
    ),
    (
        "f s",
        &[
            "modes_agree_where_returns_stand_alone_and_refine_on_request_where_they_overlap",
            "lines/values_and_modes",
        ],
    ),
    (
        "a slow",
        &[
            "modes_agree_where_returns_stand_alone_and_refine_on_request_where_they_overlap",
            "lines/values_and_modes",
        ],
    ),
    ("d", &["noise_alone_gives_no_more_returns_than_theory", "lines_of_version_1_0"]),
    (
        "min_width max_width",
        &["clear_returns_beyond_the_range_of_widths_are_flagged", "lines/values_and_modes"],
    ),
    (
        "out_min_a out_max_h",
        &[
            "false_returns_of_waveforms_are_withheld",
            "false_returns_are_marked_and_waveforms_that_jump_rejected",
        ],
    ),
    ("1.0:F 1.0:R 1.0:A icf icr ica", &["intensities_follow_their_closed_forms", "lines/values_and_modes"]),
    ("1.0:dt", &["a_time_offset_moves_points_along_their_beams"]),
    ("odd_dt", &["odd_samples_that_come_late_bias_no_range"]),
    (
        "t_err",
        &[
            "a_timing_error_widens_the_deviation_of_every_range",
            "single_returns_are_not_divided_and_pairs_have_true_uncertainties",
        ],
    ),
    ("olas olaz otxt", &["lines/outputs", "text_says_what_las_says"]),
    ("oparse", &["rows_hold_what_las_would", "every_letter_stands_once_and_every_attribute_has_its_number"]),
    ("o12", &["version_1_2_clamps_what_its_fields_cannot_hold", "lines_of_version_1_1"]),
    ("olax", &["an_index_is_a_file_or_a_part_of_one", "lines/outputs"]),
    ("lax_append", &["lines/outputs", "lines_of_version_1_1"]),
    ("olstat", &["a_row_has_the_columns_in_their_order", "lines_of_version_1_1"]),
    ("1.1:ostat osdfstat name", &["lines/commands", "statistics_of_a_recording"]),
    ("sdfscan", &["the_line_that_scans", "statistics_of_a_recording"]),
    ("sdfscanfast", &["fast_leaves_the_samples_out_and_says_the_same_else", "lines/commands"]),
    ("det_lm", &["the_last_of_several_returns_may_have_its_own_threshold"]),
    (
        "outflt out_max_r",
        &["waveforms_or_points_may_be_left_alone", "false_returns_of_waveforms_are_withheld"],
    ),
    ("emflt", &["crosstalk_is_flagged_and_dropped_on_request"]),
    (
        "bge",
        &[
            "a_background_per_waveform_keeps_its_level_out_of_the_amplitude",
            "long_pulses_without_free_samples_come_through_unattended",
        ],
    ),
    ("decay_a decay_t", &["a_given_tail_is_taken_off_before_everything_else"]),
    (
        "t_min t_max",
        &["a_window_is_sought_and_its_shots_are_those_of_the_whole", "the_line_with_a_clock_of_utc"],
    ),
    ("t_adj", &["a_window_may_count_another_scale_than_the_recording"]),
    ("utc t_corr", &["leap_seconds_and_an_offset_are_added", "the_line_with_a_clock_of_utc"]),
    ("gps_date", &["a_file_without_its_date_lacks_the_week_unless_the_job_says_the_day"]),
    ("n_ppm", &["the_air_may_be_another_than_the_recording_says"]),
    ("ibrc", &["the_range_table_moves_the_echo_and_adds_its_slope_to_the_deviation"]),
    ("ibrc_fit", &["noisy_range_tables_are_smoothed_by_default"]),
    ("ibic", &["amplitudes_by_the_instruments_tables_are_riegls"]),
    (
        "awc awc1",
        &[
            "given_widths_change_thickness_and_deviations_with_them",
            "automatic_widths_make_flat_targets_as_wide_as_the_pulse",
        ],
    ),
    (
        "po",
        &[
            "the_lines_of_version_1_1_with_a_pof",
            "the_lines_of_version_1_1_with_an_sbet",
            "points_are_off_by_what_their_ranges_are",
        ],
    ),
    ("po_adj po_day", &["trajectories_that_count_in_another_way", "the_lines_with_a_trajectory_in_text"]),
    ("po_rad", &["a_text_with_angles_in_radians_gives_the_same_points", "angles_of_a_text_may_be_radians"]),
    ("po_parse", &["the_lines_with_a_trajectory_in_text", "lines/commands"]),
    ("plot_po po_sub", &["trajectory_is_projected_and_thinned", "lines/commands"]),
    ("mount", &["a_scanner_mounted_in_another_way", "the_line_with_a_zone_and_feet"]),
    ("calib_corr", &["a_calibration_may_stand_in_a_file", "numbers_stand_in_the_classic_order"]),
    ("wkt", &["every_dialect_gives_the_same_coordinates", "the_lines_of_version_1_1_with_an_sbet"]),
    ("utm", &["a_zone_and_a_unit_can_be_chosen", "lines/coordinates"]),
    ("geo", &["geodetic_coordinates_are_degrees", "the_lines_with_a_trajectory_in_text"]),
    ("ecef", &["earth_centred_coordinates_are_metres"]),
    ("geoid", &["a_conic_in_feet_with_a_geoid", "a_geoid_is_found_in_any_case"]),
    (
        "metre feet int_feet",
        &["a_zone_and_a_unit_can_be_chosen", "a_requested_unit_applies_to_all_coordinates"],
    ),
    ("dumv", &["a_dummy_velocity_lays_lines_side_by_side"]),
];

/// Features without an option: description, key or command, and tests.
pub const FEATURES: &[(&str, &str, &[&str])] = &[
    (
        "several inputs, outputs named after each",
        "`path` of a reader, `*` in outputs",
        &["patterns_give_files_in_order_each_once", "inputs_whose_outputs_would_have_the_same_names"],
    ),
    (
        "a file of persistent options",
        "`wavex import`, `[job] include`",
        &["lines/files_of_options", "included_keys_count_where_the_job_gives_none"],
    ),
    (
        "one run per output folder",
        "a lock",
        &["a_second_run_on_the_same_outputs_is_refused_while_the_first_lives"],
    ),
    (
        "global statistics",
        "`[job] stat_log`",
        &[
            "the_statistics_in_words_have_every_part",
            "what_the_geometry_says_stands_in_the_statistics",
            "a_bad_input_costs_only_its_own_outputs",
        ],
    ),
    ("errors of appendix A1", "messages", &["the_table_of_messages_names_tests_that_exist"]),
    (
        "LAS with waveforms",
        "`read_las`",
        &[
            "las_and_laz_twins_hold_the_points_that_the_las_crate_reads",
            "packets_hold_the_samples_of_the_pulsewaves_twin",
        ],
    ),
    ("PulseWaves", "`read_pulsewaves`", &["every_sample_is_as_the_peer_reads_it"]),
    (
        "SDF",
        "`read_sdf`",
        &[
            "a_recording_comes_out_as_read_arrow_gives_it_to_the_byte",
            "the_whole_chain_runs_on_a_raw_recording",
        ],
    ),
    (
        "open container",
        "`read_arrow`, `write_arrow`",
        &["containers_of_pyarrow_are_read", "what_is_written_comes_back"],
    ),
    (
        "online points",
        "`online_points` of `decompose`",
        &[
            "shots_without_a_waveform_have_the_instruments_returns",
            "they_can_be_left_out_or_stand_in_for_all",
            "the_report_compares_them_with_computed_ones",
        ],
    ),
    (
        "declared coordinate reference system",
        "`crs_of_input` of the readers",
        &[
            "the_map_of_a_recording_can_be_declared",
            "coordinates_may_be_asked_for_in_the_map_that_is_declared",
            "a_declared_map_that_cannot_be_used_is_refused",
        ],
    ),
    (
        "MTA zone",
        "`zone` of `resolve_mta`",
        &["a_fixed_zone_needs_nothing_else", "each_echo_gets_the_shot_that_caused_it"],
    ),
    (
        "MTA method and buffer",
        "`method`, `buffer` of `resolve_mta`",
        &["the_least_variance_resolves_bare_ground", "ten_scenes_come_back_by_both_doors"],
    ),
    (
        "MTA at a constant pulse rate",
        "`agl_m`, `terrain` of `resolve_mta`",
        &[
            "a_constant_rate_without_a_prior_is_refused",
            "a_height_above_ground_resolves_a_constant_rate",
            "a_terrain_model_resolves_a_constant_rate",
        ],
    ),
    (
        "channel fusion",
        "`fuse_channels`",
        &["ranges_across_the_hand_over_reach_the_joint_bound_without_a_step"],
    ),
    (
        "automatic calibration",
        "`calibrate`",
        &["calibration_finds_the_instrument", "too_few_waveforms_say_how_many_there_were"],
    ),
    (
        "saved and preset models",
        "`save`, `load`, `preset` of `calibrate`, `wavex calibrate`, `survey_model`",
        &[
            "a_saved_sensor_model_gives_the_same_returns_again",
            "a_preset_serves_where_there_is_too_little_to_calibrate_from",
            "a_model_is_saved_and_serves_another_recording",
        ],
    ),
    (
        "user data bits",
        "flags of returns",
        &["the_page_on_returns_names_every_flag", "a_point_tells_of_its_return_in_version_1_4"],
    ),
    (
        "false-alarm rates",
        "`wavex false-alarms`",
        &["the_table_has_a_row_per_threshold_and_a_column_per_correlation"],
    ),
    (
        "outliers: withheld, class 20",
        "`filter_outliers`",
        &["low_points_are_low_and_air_points_are_in_the_air"],
    ),
    (
        "automatic gain control",
        "`blocks.gain` of containers, `gain_range` of `simulate`",
        &["fast_kernels_are_right_at_every_gain", "noise_gives_as_many_false_returns_as_at_one_gain"],
    ),
    ("export of waveforms", "`wave_packets` of `write_las`", &["decomposing_again_gives_the_same_returns"]),
    (
        "line statistics of both versions",
        "`layout` of `write_lstat`",
        &["the_columns_are_those_of_the_documents"],
    ),
    ("tables in full precision", "`write_table`", &["arrow_and_parquet_hold_the_same_columns"]),
];
