//! Whole runs of the laser R-test by the program itself, against a simulated control and a sensor on a
//! wire of this test: what becomes of them when the sensor fails in mid-scan, when the program is killed,
//! when the sphere is moved meanwhile, and beside load. Scans in motion: against a control that stamps, played
//! by the test as well.

#[path = "../cli_run/bench.rs"]
mod bench;
mod fails;
mod kills;
mod load;
mod memory;
mod played;
mod refused;
mod sender;
mod shop;
#[path = "../support/mod.rs"]
mod support;
mod sweeps;
