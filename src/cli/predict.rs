//! `trued predict`: computes the position error of the tool at given poses from an estimate.

use std::path::Path;

use super::failure::CommandFailure;
use super::files::read_estimate;
use super::result_args::PredictPoseErrorsArgs;
use crate::setup;
use machine::record::machine::Machine;
use machine::{Axis, Position};
use methods::identification::StatedStylusUncertainty;
use methods::prediction::{ErrorPredictor, PoseError, WorkZero};

/// Columns of a table of poses, linear axes in mm and rotary axes in degrees.
const POSE_COLUMNS: [(&str, Axis); 7] = [
    ("x_mm", Axis::X),
    ("y_mm", Axis::Y),
    ("z_mm", Axis::Z),
    ("a_deg", Axis::A),
    ("b_deg", Axis::B),
    ("c_deg", Axis::C),
    ("s_deg", Axis::S),
];

pub fn predict_command(args: &PredictPoseErrorsArgs) -> Result<(), CommandFailure> {
    let estimate = read_estimate(&args.estimate)?;
    let file = setup::load_machine_file(args.machine.as_deref(), &estimate.method)?;
    let stylus = StatedStylusUncertainty::new(&file.probe, &file.assumed_keys);
    let machine = file.machine;
    let zero_at = args.zero.as_deref().map(parse_pose).transpose()?;
    let zero = match &zero_at {
        _ if args.without_tool_centre_control => WorkZero::EachRotaryPosition,
        Some(at) => WorkZero::Pose(at.clone()),
        None => WorkZero::TableOrigin,
    };
    let predictor = ErrorPredictor::new(&machine, stylus, &estimate, zero)?;
    if let Some(zero) = zero_at.as_ref().filter(|_| !args.extrapolate) {
        let refused = |why: methods::MethodRefusal| CommandFailure::new(format!("--zero: {}", why.reason), why.remedy);
        predictor.check_measured_range(zero).map_err(refused)?;
    }
    let (axes, poses) = match &args.at {
        Some(file) => {
            let (axes, poses) = read_pose_table(file, &machine)?;
            if !args.extrapolate {
                check_poses_in_measured_ranges(&predictor, file, &poses)?;
            }
            (axes, poses.into_iter().map(|(at, _)| at).collect())
        }
        None => (Vec::new(), predictor.volume_grid_poses()?),
    };
    let tips = predictor.tip_errors(&poses);
    if !axes.is_empty() {
        print_pose_errors(&axes, &poses, &predictor.pose_errors(&poses, &tips));
    }
    errln!("{}", predictor.describe_model());
    for line in ErrorPredictor::describe_volume_errors(predictor.volume_errors(&poses, &tips), &poses) {
        errln!("{line}");
    }
    if let Some(corrected) = &args.corrected {
        let symbols: Vec<&str> = match corrected.as_str() {
            "all" => predictor.predicted_error_symbols().to_vec(),
            some => some.split(',').collect(),
        };
        errln!("{}", predictor.describe_error_after_correction(&symbols, &poses)?);
    }
    Ok(())
}

/// Checks that no pose is outside the measured ranges. `poses`: each with its line in `file`.
fn check_poses_in_measured_ranges(
    predictor: &ErrorPredictor<'_>,
    file: &Path,
    poses: &[(Position, u64)],
) -> Result<(), CommandFailure> {
    for (at, line) in poses {
        let refused = |why: methods::MethodRefusal| {
            CommandFailure::new(format!("{}, line {line}: {}", file.display(), why.reason), why.remedy)
        };
        predictor.check_measured_range(at).map_err(refused)?;
    }
    Ok(())
}

/// Parses a pose such as `X100 Y0 Z300 B0 C90`; axes that are not named are at 0.
fn parse_pose(text: &str) -> Result<Position, CommandFailure> {
    let wrong = |word: &str| {
        CommandFailure::new(
            format!("--zero: `{word}` is not an axis position"),
            "write a pose as \"X100 Y0 Z300 B0 C90\", in mm and degrees",
        )
    };
    let value = |word: &str| -> Option<(Axis, f64)> {
        let (letter, number) = word.split_at_checked(1)?;
        let axis: Axis = letter.parse().ok()?;
        let value: f64 = number.parse().ok()?;
        value.is_finite().then(|| (axis, axis.to_mm_or_rad(value)))
    };
    text.split_whitespace().map(|word| value(word).ok_or_else(|| wrong(word))).collect()
}

/// Axes with the names of their columns, and poses with their line numbers.
type PoseTable = (Vec<(&'static str, Axis)>, Vec<(Position, u64)>);

/// Reads the poses: the axes in the order of the columns, and each pose with its line.
fn read_pose_table(file: &Path, machine: &Machine) -> Result<PoseTable, CommandFailure> {
    let wrong = |line: u64, why: String| {
        CommandFailure::new(
            format!("{}, line {line}: {why}", file.display()),
            "write a table with some of the columns x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,s_deg and one pose per \
            line",
        )
    };
    let text = std::fs::read_to_string(file).map_err(|error| CommandFailure::from_file_error(file, &error))?;
    let mut rows = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(text.as_bytes());
    let head = rows.headers().map_err(|error| wrong(1, error.to_string()))?;
    let known = |name: &str| POSE_COLUMNS.into_iter().find(|(column, _)| *column == name);
    let axes = head
        .iter()
        .map(|name| known(name).ok_or_else(|| wrong(1, format!("the column `{name}` is not known"))))
        .collect::<Result<Vec<_>, _>>()?;
    for (number, (name, axis)) in axes.iter().enumerate() {
        if axes[..number].iter().any(|(_, other)| other == axis) {
            return Err(wrong(1, format!("the column `{name}` occurs twice")));
        }
        if !machine.axes.contains_key(axis) {
            return Err(wrong(1, format!("the column `{name}` is not allowed: {} has no axis {axis}", machine.name)));
        }
    }
    let mut poses = Vec::new();
    for row in rows.records() {
        let row = row.map_err(|error| wrong(error.position().map_or(1, csv::Position::line), error.to_string()))?;
        let line = row.position().map_or(0, csv::Position::line);
        let mut at = Position::new();
        for ((_, axis), text) in axes.iter().zip(&row) {
            let value: f64 = text
                .parse()
                .ok()
                .filter(|value: &f64| value.is_finite())
                .ok_or_else(|| wrong(line, format!("`{text}` is not a position of {axis}")))?;
            at.set(*axis, axis.to_mm_or_rad(value));
        }
        poses.push((at, line));
    }
    if poses.is_empty() {
        return Err(wrong(1, "the table contains no pose".to_owned()));
    }
    Ok((axes, poses))
}

fn print_pose_errors(axes: &[(&str, Axis)], poses: &[Position], errors: &[PoseError]) {
    let names: Vec<&str> = axes.iter().map(|(name, _)| *name).collect();
    outln!(
        "{},ex_um,ey_um,ez_um,u_ex_um,u_ey_um,u_ez_um,ei_urad,ej_urad,ek_urad,u_ei_urad,u_ej_urad,u_ek_urad",
        names.join(",")
    );
    for (at, error) in poses.iter().zip(errors) {
        let place = axes.iter().map(|(_, axis)| format!("{}", axis.to_mm_or_deg(at.get_or_zero(*axis))));
        let tip = [error.tip_error_mm, error.u_tip_error_mm].map(|mm| mm * 1e3);
        let direction = [error.direction_error_rad, error.u_direction_error_rad].map(|rad| rad * 1e6);
        let numbers = tip.iter().chain(&direction).flat_map(|v| [v.x, v.y, v.z]);
        let cells: Vec<String> = place.chain(numbers.map(|value| format!("{value:.3}"))).collect();
        outln!("{}", cells.join(","));
    }
}
