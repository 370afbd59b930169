//! SAMBA on other machines than the built-in one, from the machine file to the estimate, as a user runs it: the
//! default set of errors is identified, and errors that are not identifiable are listed.

use crate::support::harness::{Pool, Trials, trials};
use std::process::Command;

use toml::{Table, Value};

/// The built-in machine with other axes and other errors: topology, travel of each rotary axis to both sides in
/// degrees, true errors with their units.
struct SambaMachineVariant<'a> {
    topology: &'a str,
    rotary_half_ranges_deg: &'a [(&'a str, f64)],
    true_errors: &'a [(&'a str, f64)],
}

impl SambaMachineVariant<'_> {
    fn machine_file_text(&self) -> String {
        let mut file: Table = include_str!("../../config/samba.toml").parse().unwrap();
        let table = |value: &str| Value::Table(value.parse().unwrap());
        let mut set = |path: &[&str], value: Option<Value>| {
            let (key, tables) = path.split_last().unwrap();
            let mut at = &mut file;
            for name in tables {
                at = at.entry(*name).or_insert_with(|| Value::Table(Table::new())).as_table_mut().unwrap();
            }
            match value {
                Some(value) => drop(at.insert((*key).to_owned(), value)),
                None => drop(at.remove(*key)),
            }
        };
        set(&["machine", "topology"], Some(self.topology.into()));
        set(&["machine", "drift_um_per_h"], Some(0.0.into()));
        for axis in ["B", "C", "S"] {
            set(&["axes", axis], None);
        }
        for (axis, reach) in self.rotary_half_ranges_deg {
            let spec = format!("positive = \"iso\"\nmin = -{reach}.0\nmax = {reach}.0");
            set(&["axes", axis], Some(table(&spec)));
        }
        let errors = self.true_errors.iter().map(|(name, value)| ((*name).to_owned(), (*value).into()));
        set(&["simulated", "errors"], Some(Value::Table(errors.collect())));
        set(&["simulated", "error_motion"], None);
        // The cradle is attached to an axis that not all of these machines have.
        set(&["solid"], None);
        let settings = "balls = 48\nindexations = 16\nmonte_carlo_trials = 100";
        set(&["method", "samba"], Some(table(settings)));
        toml::to_string(&file).unwrap()
    }

    fn run_samba(&self) -> serde_json::Value {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("machine.toml");
        std::fs::write(&path, self.machine_file_text()).unwrap();
        let ran = Command::new(env!("CARGO_BIN_EXE_trued"))
            .args(["run", "samba", "--json", "--speed", "fast", "--machine"])
            .arg(&path)
            .arg("--state")
            .arg(folder.path().join("state"))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&ran.stderr);
        assert!(ran.status.success(), "{}: {said}", self.topology);
        serde_json::from_slice(&ran.stdout).unwrap()
    }

    /// Checks that the machine errors among the parameters are exactly `expected` (symbol, true value), each within
    /// 3.5 standard uncertainties.
    #[track_caller]
    fn run_and_check_errors(&self, expected: &[(&str, f64)]) -> serde_json::Value {
        let estimate = self.run_samba();
        let number = |parameter: &serde_json::Value, key: &str| parameter[key].as_f64().unwrap();
        let mut found = Vec::new();
        for parameter in estimate["parameters"].as_array().unwrap() {
            let symbol = parameter["symbol"].as_str().unwrap();
            if !symbol.starts_with('E') {
                continue;
            }
            let (value, u) = (number(parameter, "value"), number(parameter, "u"));
            println!("{}: {symbol} {value:.2} ± {u:.2}", self.topology);
            let truth = expected.iter().find(|(name, _)| *name == symbol);
            let (_, truth) = truth.unwrap_or_else(|| panic!("{symbol} is not in the set"));
            assert!((value - truth).abs() < 3.5 * u, "{symbol}: {value} ± {u}, true {truth}");
            found.push(symbol.to_owned());
        }
        assert_eq!(found.len(), expected.len(), "{}: {found:?}", self.topology);
        estimate
    }
}

/// Checks the machine errors in `not_identifiable`: the lines that start with a symbol.
#[track_caller]
fn assert_not_identifiable(estimate: &serde_json::Value, expected: &[(&str, &str)]) {
    let lines: Vec<&str> = estimate["not_identifiable"]
        .as_array()
        .unwrap()
        .iter()
        .map(|line| line.as_str().unwrap())
        .filter(|line| line.starts_with('E'))
        .collect();
    println!("{lines:#?}");
    assert_eq!(lines.len(), expected.len(), "{lines:#?}");
    for (symbol, words) in expected {
        let line = lines.iter().find(|line| line.starts_with(&format!("{symbol}: ")));
        assert!(line.is_some_and(|line| line.contains(words)), "{symbol}: {words}\n{lines:#?}");
    }
}

/// ISO 10791-6 names errors of B in the head. With the spindle upright they are not identifiable, and with A as the
/// only rotary axis one length gives only the scale of X.
fn fork_head_lists_errors_unidentifiable_when_upright() {
    let fork = SambaMachineVariant {
        topology: "w-A-F-X-Y-Z-B-t",
        rotary_half_ranges_deg: &[("A", 110.0), ("B", 110.0)],
        true_errors: &[
            ("EB0A_urad", 7.0),
            ("EC0A_urad", -15.0),
            ("EA0Z_urad", 12.0),
            ("EB0Z_urad", -9.0),
            ("EC0Y_urad", 21.0),
            ("EXX1_um_per_m", -16.0),
            ("EYY1_um_per_m", 11.0),
            ("EZZ1_um_per_m", 21.0),
            ("EA0B_urad", 30.0),
            ("EZ0B_um", 20.0),
        ],
    };
    let estimate = fork.run_and_check_errors(&[
        ("EB0A", 7.0),
        ("EC0A", -15.0),
        ("EA0Z", 12.0),
        ("EB0Z", -9.0),
        ("EC0Y", 21.0),
        ("EXX1", -16.0),
        ("EYY1", 11.0 - 21.0),
    ]);
    let upright = "balls are touched from above only";
    assert_not_identifiable(
        &estimate,
        &[
            ("EZ0B", "tool_z is reported as tool_z + EZ0B"),
            ("EA0B", upright),
            ("EC0B", upright),
            ("EZZ1", "EYY1 is reported as EYY1 - EZZ1"),
        ],
    );
}

fn trunnion_of_a_and_c_identifies_all_errors() {
    let errors = [
        ("EB0A_urad", 7.0),
        ("EC0A_urad", -15.0),
        ("EY0C_um", 40.0),
        ("EA0C_urad", 12.0),
        ("EB0C_urad", -9.0),
        ("EA0Z_urad", 12.0),
        ("EB0Z_urad", -9.0),
        ("EC0Y_urad", 21.0),
        ("EXX1_um_per_m", -16.0),
        ("EYY1_um_per_m", 11.0),
        ("EZZ1_um_per_m", 21.0),
    ];
    let expected = errors.map(|(name, value)| (name.split_once('_').unwrap().0, value));
    let turning = &[("A", 110.0), ("C", 360.0)];
    let trunnion =
        SambaMachineVariant { topology: "w-C-A-Y-F-X-Z-t", rotary_half_ranges_deg: turning, true_errors: &errors };
    assert_not_identifiable(&trunnion.run_and_check_errors(&expected), &[]);
}

/// No axis turns across Z: its gain is left out and listed.
fn with_c_as_only_rotary_axis_z_gain_is_not_identifiable() {
    let errors = [
        ("EA0C_urad", 12.0),
        ("EB0C_urad", -9.0),
        ("EA0Z_urad", 12.0),
        ("EB0Z_urad", -9.0),
        ("EC0Y_urad", 21.0),
        ("EXX1_um_per_m", -16.0),
        ("EYY1_um_per_m", 11.0),
    ];
    let expected = errors.map(|(name, value)| (name.split_once('_').unwrap().0, value));
    let errors = [&errors[..], &[("EZZ1_um_per_m", 21.0)]].concat();
    let four = SambaMachineVariant {
        topology: "w-C-F-X-Y-Z-t",
        rotary_half_ranges_deg: &[("C", 360.0)],
        true_errors: &errors,
    };
    assert_not_identifiable(
        &four.run_and_check_errors(&expected),
        &[("EZZ1", "inseparable from the positions of the balls")],
    );
}

/// With B or A as the only rotary axis, the length along X, slightly slanted, gives no scale across it.
fn single_tilting_axis_leaves_one_linear_gain_unidentifiable() {
    let linear = [
        ("EA0Z_urad", 12.0),
        ("EB0Z_urad", -9.0),
        ("EC0Y_urad", 21.0),
        ("EXX1_um_per_m", -16.0),
        ("EYY1_um_per_m", 11.0),
        ("EZZ1_um_per_m", 21.0),
    ];
    for (axis, own, gains, (lost, words)) in [
        (
            "B",
            [("EA0B_urad", 7.0), ("EC0B_urad", -15.0)],
            [("EXX1", -16.0), ("EZZ1", 21.0)],
            ("EYY1", "inseparable from the positions of the balls"),
        ),
        (
            "A",
            [("EB0A_urad", 7.0), ("EC0A_urad", -15.0)],
            [("EXX1", -16.0), ("EYY1", 11.0 - 21.0)],
            ("EZZ1", "EYY1 is reported as EYY1 - EZZ1"),
        ),
    ] {
        let errors = [&own[..], &linear].concat();
        let angles = errors.iter().filter(|(name, _)| name.ends_with("urad"));
        let mut expected: Vec<_> = angles.map(|(name, value)| (name.split_once('_').unwrap().0, *value)).collect();
        expected.extend(gains);
        let topology = format!("w-{axis}-F-X-Y-Z-t");
        let four =
            SambaMachineVariant { topology: &topology, rotary_half_ranges_deg: &[(axis, 110.0)], true_errors: &errors };
        assert_not_identifiable(&four.run_and_check_errors(&expected), &[(lost, words)]);
    }
}

/// Without an axis S two offsets of the spindle are contained in those of the stylus; this is listed.
fn without_axis_s_spindle_offsets_are_not_identifiable() {
    let errors = [
        ("EA0B_urad", -11.0),
        ("EC0B_urad", -8.0),
        ("EX0C_um", -105.0),
        ("EA0C_urad", -11.0),
        ("EB0C_urad", -8.0),
        ("EB0Z_urad", -13.0),
        ("EA0Y_urad", -18.0),
        ("EC0Y_urad", 21.0),
        ("EXX1_um_per_m", -16.0),
        ("EYY1_um_per_m", 11.0),
        ("EZZ1_um_per_m", 21.0),
    ];
    let expected = errors.map(|(name, value)| (name.split_once('_').unwrap().0, value));
    let errors = [&errors[..], &[("EX0S_um", -106.0), ("EY0S_um", 20.0)]].concat();
    let turning = &[("B", 110.0), ("C", 360.0)];
    let still =
        SambaMachineVariant { topology: "w-C-B-X-F-Z-Y-S-t", rotary_half_ranges_deg: turning, true_errors: &errors };
    let estimate = still.run_and_check_errors(&expected);
    assert_not_identifiable(
        &estimate,
        &[
            ("EX0S", "the spindle was not turned), so tool_x is reported as tool_x + EX0S"),
            ("EY0S", "so tool_y is reported as tool_y + EY0S"),
        ],
    );
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 20;
        fork_head_lists_errors_unidentifiable_when_upright,
        trunnion_of_a_and_c_identifies_all_errors,
        with_c_as_only_rotary_axis_z_gain_is_not_identifiable,
        single_tilting_axis_leaves_one_linear_gain_unidentifiable,
        without_axis_s_spindle_offsets_are_not_identifiable,
    ]
}
