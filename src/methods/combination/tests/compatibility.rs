//! Which runs are combined.

use super::{TestRun, combine};
use crate::combination::CombinationRefusal;
use machine::record::estimate::{Unit, Verdict};

#[test]
fn runs_that_are_not_comparable_are_refused() {
    let refused = |change: fn(&mut TestRun)| {
        let mut runs = [1, 2].map(|number| TestRun::of_one_parameter(number, 5.0, 1.0));
        change(&mut runs[1]);
        let refusal = combine(&runs).unwrap_err();
        assert!(!refusal.remedy().is_empty());
        refusal.to_string()
    };
    assert!(refused(|run| run.number = 1).contains("listed twice"));
    assert!(refused(|run| run.plan.machine.name = "lathe".to_owned()).contains("the machine `lathe`"));
    assert!(refused(|run| run.plan.method = "r-test".to_owned()).contains("the method r-test"));
    assert!(refused(|run| run.plan.machine.topology = "w-C-B-b-X-Y-Z-(S)-t".to_owned()).contains("topology"));
    assert!(refused(|run| run.plan.probe.stylus = "no. 13".to_owned()).contains("the stylus"));
    assert!(refused(|run| run.plan.machine.tool_mm = [0.0, 0.0, -9.0]).contains("the stylus"));
    assert!(refused(|run| run.plan.compensations_active = vec!["K1".to_owned()]).contains("compensations"));
    assert!(refused(|run| run.estimate.verdict = Verdict::UndecidedModel).contains("contradict its model"));
    assert!(refused(|run| run.estimate.gauge[0].push('°')).contains("relative to C = 0"));
    assert!(refused(|run| run.estimate.location_at_mm = Some([0.0; 3])).contains("different points"));
    let held = refused(|run| run.estimate.held_at_zero = vec!["EX0C".to_owned()]);
    assert_eq!(held, "run 2 holds EX0C at zero, run 1 estimates it");
    assert!(refused(|run| run.estimate.parameters[0].unit = Unit::Mm).contains("units for EX0C"));
    assert!(refused(|run| run.estimate.covariance.rows[0][0] = f64::NAN).contains("no uncertainty"));
    let renamed = refused(|run| {
        run.estimate.covariance.symbols[0] = "EY0C".to_owned();
        run.estimate.parameters[0].symbol = "EY0C".to_owned();
    });
    assert!(renamed.contains("no parameter in common"));
    let alone = [TestRun::of_one_parameter(1, 5.0, 1.0)];
    assert_eq!(combine(&alone).unwrap_err(), CombinationRefusal::TooFewRuns);
}

/// The measured position in a convention may differ.
#[test]
fn measured_values_in_a_convention_may_differ() {
    let run = |number, text: &str| {
        let mut run = TestRun::of_one_parameter(number, 5.0, 1.0);
        run.estimate.gauge[0] = format!("configured [0, 0, 0], measured [{text}]");
        run
    };
    let combined = combine(&[run(1, "0.05, 0, 0"), run(2, "0.06, 0, 0")]).unwrap();
    assert_eq!(combined.estimate.gauge[0], "configured [0, 0, 0]");
}
