//! Scans in motion on a control that does not report time-stamped axis positions.

use super::{MachineShop, assert_stderr_has};

pub fn scan_in_motion_without_time_stamped_positions_is_refused() {
    let file = include_str!("../../../config/laser.toml");
    let settings = "sampling = \"continuous\"\ntilt_deg = [-60.0, 60.0]\nturn_deg = [120.0, 240.0]";
    let shop = MachineShop::with_machine_file(&format!("{file}\n[method.laser-r-test]\n{settings}\n"));
    let machine = shop.path_text("machine.toml");
    let run = shop.run_trued(&["run", "laser-r-test", "--json", "--machine", &machine]);
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    assert_stderr_has(&run, &["does not report time-stamped axis positions", "dwell points", "[controller.sampler]"]);
    // The run is refused before it starts, not held midway.
    assert_eq!(shop.run_states(), ["failed"]);
}
