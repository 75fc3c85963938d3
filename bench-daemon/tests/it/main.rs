//! Integration tests of the daemon: one binary.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may end a test"
)]

mod accuracy;
mod additions;
mod analog;
mod architecture;
mod attack_matrix;
mod bad_day;
mod batch;
mod bath;
mod bath_runaway;
mod bath_safe;
mod bench_lease;
mod benches;
mod bias;
mod book;
mod campaign;
mod campaign_benches;
mod catalog;
#[cfg(feature = "otlp")]
mod collector;
mod commands;
mod configuration;
mod convert;
mod corpus;
mod coverage;
mod crash;
mod crash_ahead;
mod dataset_init;
mod demo;
mod diagnose;
mod doctor;
mod exchanged;
mod fit;
mod fit_circuit;
mod guardian;
mod hidden_effects;
mod hppc;
mod identify;
mod investigate;
mod kill;
mod kk;
mod lies;
mod map;
mod map_next;
mod map_points;
mod mock_process;
mod multisine;
mod observe;
mod ocv_joint;
mod ocv_soc;
mod operando;
#[cfg(feature = "otlp")]
mod otlp;
mod outputs_state;
mod overlap;
mod pack_heat;
mod pack_links;
mod profiles;
mod quality;
mod ranging;
mod real_data;
mod records;
mod reference;
mod replay;
mod resume;
mod robust;
mod robust_models;
mod safety;
mod schema;
mod serve;
mod serve_access;
mod serve_ask;
mod serve_files;
mod serve_find;
mod serve_investigate;
mod serve_load;
mod serve_notices;
mod serve_page;
mod serve_stop;
mod serve_support;
mod simulate;
mod soc_reset;
mod structure;
mod support;
mod sweeps;
mod thermometers;
mod thresholds;
mod traces;
mod typed;
mod under_test;
mod upgrade;
mod verdicts;
mod watch;
mod wrong_numbers;
