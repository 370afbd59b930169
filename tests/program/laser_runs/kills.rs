//! The program is killed during a run. The readings of the run are still stored, and the run can be resumed, unless
//! the sphere was moved meanwhile.

use super::laser_shop::{
    FIRST_REFERENCE_STEP, LaserShop, SOUND_ESTIMATE_DESIGN, SPHERE_SEARCH_STEP, assert_near_truth, estimate_of_output,
};
use crate::support::grbl_control::GrblControl;
use crate::support::machine_shop::stderr;

/// A run that was killed during a move between points of a pose.
fn shop_with_killed_run() -> LaserShop {
    let shop =
        LaserShop::with_control(SOUND_ESTIMATE_DESIGN, GrblControl::start(&SOUND_ESTIMATE_DESIGN.machine_file_text()));
    let way = format!("N{} G53 G1", FIRST_REFERENCE_STEP + 2);
    shop.bench.cut_session_at(&[&way, &way, &way, &way]);
    let mut run = shop.start_run();
    shop.bench.wait_for_session_cut(&mut run);
    run.kill().unwrap();
    run.wait().unwrap();
    shop.bench.reset_and_home();
    shop
}

pub fn killed_run_resumes_to_the_estimate_of_an_undisturbed_run() {
    let shop = shop_with_killed_run();
    assert_eq!(
        shop.check_readings_and_return_steps(),
        (SPHERE_SEARCH_STEP..FIRST_REFERENCE_STEP + 2).collect::<Vec<_>>()
    );
    let resumed = shop.resume();
    let found = estimate_of_output(&resumed);
    assert!(stderr(&resumed).contains("the references agree"), "{}", stderr(&resumed));
    let whole =
        LaserShop::with_control(SOUND_ESTIMATE_DESIGN, GrblControl::start(&SOUND_ESTIMATE_DESIGN.machine_file_text()));
    let undisturbed = estimate_of_output(&whole.start_run().wait_with_output().unwrap());
    assert_near_truth(&found, 5.0);
    for (one, other) in found.parameters.iter().zip(&undisturbed.parameters) {
        assert_eq!(one.symbol, other.symbol);
        // E_n of two measurements: 1 at two standard uncertainties of their difference. When the run is killed depends
        // on the clock: at 1.5 (three standard uncertainties), one of 13 parameters exceeds the limit by chance in 3 %
        // of the runs.
        let apart = (one.value - other.value).abs() / one.expanded.hypot(other.expanded);
        println!("{}: {:.3} and {:.3}, E_n {apart:.2}", one.symbol, one.value, other.value);
        assert!(apart < 2.0, "{}: {} {}, {apart}", one.symbol, one.value, other.value);
    }
    let again = [FIRST_REFERENCE_STEP; 2].into_iter().chain(FIRST_REFERENCE_STEP + 2..SOUND_ESTIMATE_DESIGN.step_count);
    assert_eq!(
        shop.check_readings_and_return_steps(),
        (SPHERE_SEARCH_STEP..FIRST_REFERENCE_STEP + 2).chain(again).collect::<Vec<_>>()
    );
}

/// The flanks of the sphere show a shift across the beam.
pub fn resume_is_refused_after_the_sphere_was_moved() {
    // By 20 µm, along X and diagonally between X and Y: both lines of the cross show it.
    for (moved, told) in
        [("[0.32, -0.2]", "repeatability of one touch"), ("[0.314, -0.186]", " more; repeatability of one touch")]
    {
        let shop = shop_with_killed_run();
        shop.bench.replace_true_machine(&SOUND_ESTIMATE_DESIGN.machine_file_text().replacen("[0.3, -0.2]", moved, 1));
        let refused = shop.resume();
        assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
        for words in ["have shifted since the stop", told, "Start a new run"] {
            assert!(stderr(&refused).contains(words), "{moved}: no {words} in {}", stderr(&refused));
        }
        assert_eq!(shop.run_state(), "closed");
        assert!(refused.stdout.is_empty());
    }
}
