//! The budget line of an interruption equals the largest shift that the reference check accepts.

use nalgebra::{Matrix3, Vector3};

use super::simulated_machine::{SimulatedMachine, simulate_run, table_5_machine};
use super::{ideal_plan, settings_with_few_trials};
use crate::decision::reference_check::ReferencePoints;
use crate::identification::ObservationEffect;
use crate::laser_r_test::identify::{identify, identify_scans};
use crate::laser_r_test::setup::LaserSetup;
use crate::laser_r_test::sources::uncertainty_sources;
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Plan, Step, StepKind};
use machine::record::reading::Reading;

const NOISE_UM: f64 = 0.5;
/// Duration of the interruption after the first poses.
const INTERRUPTION_S: f64 = 600.0;

struct InterruptedRun {
    plan: Plan,
    readings_before: Vec<Reading>,
    readings_after: Vec<Reading>,
}

impl InterruptedRun {
    fn new() -> Self {
        let world = table_5_machine(NOISE_UM, 1);
        let (mut plan, _, readings) =
            simulate_run(ideal_plan(NOISE_UM), &settings_with_few_trials(), &world, 9).unwrap();
        let reference = plan.steps.iter().find(|step| step.kind == StepKind::Reference).unwrap().id;
        let (before, mut later): (Vec<_>, Vec<_>) =
            readings.into_iter().partition(|reading| reading.step < reference + 9);
        later.iter_mut().for_each(|reading| reading.t_s += INTERRUPTION_S);
        plan.interruption_times_s.push(before.last().unwrap().t_s);
        Self { plan, readings_before: before, readings_after: later }
    }

    /// Repeats the reference twice on a machine displaced by `by`, the first time with the noise of the original
    /// measurement.
    fn readings_of_repeated_references(&self, by: Vector3<f64>) -> Vec<Reading> {
        let step: &Step = self.plan.steps.iter().find(|step| step.kind == StepKind::Reference).unwrap();
        let mut t_s = self.plan.interruption_times_s[0] + INTERRUPTION_S / 2.0;
        let mut readings = Vec::new();
        for (round, seed) in [(0, 1), (1, 9)] {
            let world = table_5_machine(NOISE_UM, seed);
            let mut taken =
                SimulatedMachine { zero_point: world.zero_point + by, ..world }.simulate_step(step, 0.0, &mut t_s);
            taken.iter_mut().for_each(|reading| reading.repeat = FIRST_REPEAT_NUMBER_AFTER_STOP + round);
            readings.extend(taken);
        }
        readings
    }

    /// Whether the reference check accepts the displacement `by`.
    fn reference_check_accepts_shift(&self, by: Vector3<f64>) -> bool {
        let (shifts, _) = ReferencePoints::from_readings(&self.plan, &self.readings_before)
            .shifts_and_scatter_after_stop(&self.readings_of_repeated_references(by));
        shifts.len() == 26 && shifts.iter().all(|shift| shift.is_within_limit())
    }

    /// Largest displacement along `way` that the reference check accepts, mm.
    fn max_accepted_shift_mm(&self, way: Vector3<f64>) -> f64 {
        let (mut least, mut most) = (0.0, 0.1);
        while most - least > 1e-6 {
            let middle = (least + most) / 2.0;
            if self.reference_check_accepts_shift(way * middle) { least = middle } else { most = middle }
        }
        least
    }
}

/// Standard uncertainty of the shift at the interruption along X, Y and Z, mm, from the columns of the source. The
/// contribution at a spot is the component along the normal, and the squares of the components of a normal sum to 1.
fn shift_std_u_mm(columns: &[Vec<f64>]) -> Vector3<f64> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for i in (0..columns[0].len()).filter(|i| columns[2][*i] != 0.0) {
        let squares = Vector3::from([0, 1, 2].map(|k| columns[k][i].powi(2) * 1e6));
        normal += squares * squares.transpose();
        right += squares;
    }
    let inverse = normal.try_inverse().unwrap() * right;
    inverse.map(|of| 1e-3 / of.sqrt())
}

#[test]
fn interruption_source_equals_the_largest_accepted_shift() {
    let stopped = InterruptedRun::new();
    let own = settings_with_few_trials();
    let setup = LaserSetup::new(&stopped.plan, &own).unwrap();
    let [before, again, later] =
        [&stopped.readings_before, &stopped.readings_of_repeated_references(Vector3::zeros()), &stopped.readings_after];
    let readings = [before.as_slice(), again, later].concat();
    let result = identify_scans(&setup, &readings).unwrap();
    let all = uncertainty_sources(&setup, &result.observed, &result.grouped, &result.centre_fit.x, 0);
    let step = all.iter().find(|source| source.name == "steps at interruptions").unwrap();
    let ObservationEffect::Joint(columns) = &step.effect else { panic!("each by itself") };
    let granted = shift_std_u_mm(columns);
    for (k, way) in [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().enumerate() {
        let let_pass = stopped.max_accepted_shift_mm(way);
        println!("granted {:.3} um, let pass {:.3} um", granted[k] * 1e3, let_pass * 1e3);
        // The middle of the scan is that of the sphere to a few µm.
        assert!((granted[k] / let_pass - 1.0).abs() < 0.02, "{k}: {granted:?} {let_pass}");
    }
}

#[test]
fn interruption_without_references_is_refused() {
    let stopped = InterruptedRun::new();
    let own = settings_with_few_trials();
    let setup = LaserSetup::new(&stopped.plan, &own).unwrap();
    let error = identify(&setup, &[stopped.readings_before, stopped.readings_after].concat()).unwrap_err();
    println!("{error}\n  -> {}", error.remedy());
    assert!(error.to_string().contains("contain no references"), "{error}");
    assert!(error.remedy().contains("trued export"), "{}", error.remedy());
}
