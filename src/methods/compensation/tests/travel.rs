//! Tables for the travel of linear axes, applied as a running LinuxCNC 2.9 was seen to apply them.

use nalgebra::Vector3;

use super::*;

/// A table as LinuxCNC applies it to a joint: the correction is interpolated and added to the position of the motor.
pub(super) struct TableOfX {
    pub(super) nominal_mm: [f64; 3],
    pub(super) trims_mm: [f64; 3],
}

impl TableOfX {
    /// Position of the motor for a command.
    pub(super) fn motor(&self, commanded: f64) -> f64 {
        let [from, middle, to] = self.nominal_mm;
        let [low, between, high] = self.trims_mm;
        let trim = match commanded < middle {
            true => low + (between - low) * (commanded - from) / (middle - from),
            false => between + (high - between) * (commanded - middle) / (to - middle),
        };
        commanded + trim
    }

    /// The values as trims, or as actual positions, for both directions of motion.
    pub(super) fn model(&self, sign: f64) -> ControlModel {
        let mut values = Vec::new();
        let mut entries = Vec::new();
        for (nominal_mm, trim) in self.nominal_mm.into_iter().zip(self.trims_mm) {
            for direction in ["forward", "reverse"] {
                let present_mm = if sign > 0.0 { trim } else { nominal_mm - trim };
                entries.push(TravelEntry { nominal_mm, value_index: values.len(), correction_sign: sign });
                let name = format!("x.comp {nominal_mm} {direction}");
                values.push(ControlValue { name, present_mm, text: present_mm.to_string() });
            }
        }
        ControlModel::of_correction_tables(values, vec![ControlledTravel::new(Axis::X, entries).unwrap()])
    }
}

/// The readings contain the effect of the table: five corrections of a machine whose scale drifts follow it, and no
/// correction is made twice.
#[test]
fn repeated_corrections_follow_a_drifting_scale() {
    // Where X carries the tool, and where it carries the table.
    let topologies = ["w-C-B-Y-F-X-Z-S-t", "w-C-B-X-Y-F-Z-S-t"];
    for (topology, sign) in topologies.into_iter().flat_map(|topology| [(topology, 1.0), (topology, -1.0)]) {
        let mut machine = trunnion(Axis::B);
        machine.topology = topology.to_owned();
        let mut table = TableOfX { nominal_mm: [-300.0, 50.0, 300.0], trims_mm: [0.0; 3] };
        for run in 0..5 {
            let true_gain = (120.0 + 9.0 * f64::from(run)) * 1e-6;
            let tool = |commanded: f64| table.motor(commanded) * (1.0 + true_gain);
            // What a calibrated length shows, measured where the machine is used.
            let residual_um_per_m = ((tool(120.0) - tool(-80.0)) / 200.0 - 1.0) * 1e6;
            let estimate = estimate_of("samba", &[("EXX1", residual_um_per_m)], &[]);
            let measured = MeasuredAxisPositions::new(&machine, STATED, &estimate).unwrap();
            let proposal = propose(&measured, &table.model(sign), OPTIONS).unwrap();
            assert!(proposal.travels[0].kept.is_none(), "{run}: {proposal:?}");
            for (index, value) in proposal.values.chunks(2).enumerate() {
                assert_eq!(value[0].proposed_mm, value[1].proposed_mm);
                let mm = value[0].proposed_mm;
                table.trims_mm[index] = if sign > 0.0 { mm } else { table.nominal_mm[index] - mm };
            }
            let tool = |commanded: f64| table.motor(commanded) * (1.0 + true_gain);
            for commanded in [-300.0, -100.0, 80.0, 300.0] {
                let error_um = (tool(commanded) - commanded) * 1e3;
                assert!(error_um.abs() < 0.12, "run {run} at {commanded}: {error_um} µm");
            }
        }
    }
}

#[test]
fn scale_that_is_not_determined_or_insignificant_is_kept() {
    let machine = trunnion(Axis::B);
    let table = TableOfX { nominal_mm: [-300.0, 50.0, 300.0], trims_mm: [0.03, 0.0, -0.03] };
    let propose_from = |values: &[(&str, f64)]| {
        let estimate = estimate_of("samba", values, &[]);
        propose(&MeasuredAxisPositions::new(&machine, STATED, &estimate).unwrap(), &table.model(1.0), OPTIONS)
    };
    // U = 1 µm/m over 600 mm.
    let proposal = propose_from(&[("EXX1", 0.9)]).unwrap();
    assert!(proposal.values.iter().all(|value| value.present_mm == value.proposed_mm), "{proposal:?}");
    let kept = proposal.travels[0].kept.as_ref().unwrap();
    assert!(kept.reason.contains("-0.5 µm is within U = 0.6 µm"), "{kept:?}");
    let refusal = propose_from(&[("EYY1", 50.0)]).unwrap_err();
    assert!(refusal.reason.contains("does not determine the scale of X"), "{refusal:?}");
}

/// The predicted error after the write has no scale error any more.
#[test]
fn prediction_contains_the_change_of_the_table_only() {
    let machine = trunnion(Axis::B);
    let chain = KinematicChain::new(&machine).unwrap();
    let table = TableOfX { nominal_mm: [-300.0, 50.0, 300.0], trims_mm: [0.03, 0.0, -0.03] };
    let estimate = estimate_of("samba", &[("EXX1", 100.0)], &[]);
    let measured = MeasuredAxisPositions::new(&machine, STATED, &estimate).unwrap();
    let model = table.model(1.0);
    let proposal = propose(&measured, &model, OPTIONS).unwrap();
    let error_with = |values_mm: Vec<f64>| {
        let errors = model.compensated_errors(&chain, &values_mm, proposal.at_mm, |_| true).unwrap();
        let zero = WorkZero::Pose(Position::from_xyz(Vector3::zeros()));
        let predictor = ErrorPredictor::new(&machine, STATED, &estimate, zero).unwrap().with_compensated_errors(errors);
        predictor.pose_error(&Position::from_xyz(Vector3::new(100.0, 0.0, 0.0))).tip_error_mm.x * 1e3
    };
    let before_um = error_with(proposal.values.iter().map(|value| value.present_mm).collect());
    let after_um = error_with(proposal.values.iter().map(|value| value.proposed_mm).collect());
    assert!((before_um - 10.0).abs() < 1e-6 && after_um.abs() < 0.05, "{before_um} {after_um}");
}
