//! The workflow on a plain cell: what it finds, what it refuses, and what each guard is worth.

mod bench;
mod current_noise;
mod guards;
mod repeats;
mod scatter;
mod workflow;
