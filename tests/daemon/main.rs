//! `trued serve` as it lives for years: what systemd hears of it, killed at any moment, run after run, copied
//! while it measures; and the units that it is installed with.

mod client;
mod keeping;
mod kills;
mod logged;
mod shop;
mod soak;
mod supervised;
mod units;
#[path = "../durability/witness.rs"]
mod witness;
