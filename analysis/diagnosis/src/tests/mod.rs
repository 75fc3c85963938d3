//! The workflow on a plain cell: findings, refusals, and the worth of each guard.

mod bench;
mod current_noise;
mod given;
mod guards;
mod repeats;
mod scatter;
mod workflow;
