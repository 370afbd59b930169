//! Arguments for stored runs and estimates.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use methods::compensation::ProposalOptions;

#[derive(Debug, Args)]
pub struct RunsArgs {
    /// Print the list as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct ShowArgs {
    /// Number of the run; `trued runs` lists the numbers.
    pub run: i64,
    /// Print the estimate as JSON.
    #[arg(long)]
    pub json: bool,
    /// Write the report to this file.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Number of the first run; `trued runs` lists the numbers.
    pub first: i64,
    /// Number of the second run; the differences are second run minus first run.
    pub second: i64,
    /// Print the comparison as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct CombineArgs {
    /// Numbers of two or more runs of one method on one machine; `trued runs` lists the numbers.
    #[arg(required = true, num_args = 2.., value_name = "RUN")]
    pub runs: Vec<i64>,
    /// Print the combination and its estimate as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct RepeatabilityArgs {
    /// Number of one run with several passes (`trued run --repeat`), or of several runs of one method on one machine.
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<i64>,
    /// Print the table as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct CompensateArgs {
    #[command(subcommand)]
    pub action: CompensateAction,
}

#[derive(Debug, Subcommand)]
pub enum CompensateAction {
    #[command(flatten)]
    Control(ControlAction),
    /// Write a sheet of the measured errors, for a person who enters them into a control or a CAM system.
    Sheet(SheetArgs),
}

#[derive(Debug, Subcommand)]
pub enum ControlAction {
    /// Propose values from a stored run. Writes nothing to the control.
    Propose(ProposeArgs),
    /// Write the proposed values to the control and read them back.
    Write(WriteCompensationArgs),
    /// Compare a run that measured with the new values with the prediction, and store the result.
    Verify(VerifyArgs),
    /// Restore the values before the last compensation.
    Undo(DecisionArgs),
    /// Write the rest of a compensation that was interrupted, or confirm the restart of the control.
    Finish(DecisionArgs),
    /// Show the values of the control, and the last compensation.
    Status(CompensationStatusArgs),
}

impl ControlAction {
    pub fn target(&self) -> &TargetArgs {
        match self {
            Self::Propose(args) => &args.source.target,
            Self::Write(args) => &args.source.target,
            Self::Verify(args) => &args.by.target,
            Self::Undo(args) | Self::Finish(args) => &args.target,
            Self::Status(args) => &args.target,
        }
    }
}

#[derive(Debug, Args)]
pub struct TargetArgs {
    /// Machine file with the section [compensation].
    #[arg(long, value_name = "FILE")]
    pub machine: PathBuf,
    /// Key of the section [compensation], if the section has several keys.
    #[arg(long, value_name = "KIND")]
    pub target: Option<String>,
}

#[derive(Debug, Args)]
pub struct ProposalSourceArgs {
    /// Number of the run; `trued runs` lists the numbers.
    pub run: i64,
    #[command(flatten)]
    pub target: TargetArgs,
    /// Also change positions that deviate by less than their U.
    #[arg(long)]
    pub with_insignificant: bool,
    /// Largest change of a position or of a travel correction, mm; a larger change is refused.
    #[arg(long, value_name = "MM", default_value_t = ProposalOptions::DEFAULT_MAX_CHANGE_MM)]
    pub max_change_mm: f64,
}

#[derive(Debug, Args)]
pub struct ProposeArgs {
    #[command(flatten)]
    pub source: ProposalSourceArgs,
    /// Print the proposal as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct WriteCompensationArgs {
    #[command(flatten)]
    pub source: ProposalSourceArgs,
    /// SHA-256 of the approved proposal, as printed by `trued compensate propose`.
    #[arg(long, value_name = "SHA256")]
    pub approve: String,
    /// Name of the person who approves.
    #[arg(long, value_name = "NAME", value_parser = parse_person_name)]
    pub who: String,
}

#[derive(Debug, Args)]
pub struct CompensationStatusArgs {
    #[command(flatten)]
    pub target: TargetArgs,
    /// Also write the values as lines of a HAL file, into a new file.
    #[arg(long, value_name = "FILE")]
    pub hal: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct SheetArgs {
    /// Number of the run; `trued runs` lists the numbers.
    pub run: i64,
    /// The new files are NAME.html and NAME.csv.
    #[arg(long, value_name = "NAME")]
    pub out: String,
}

#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// Number of the run that measured with the new values.
    pub run: i64,
    #[command(flatten)]
    pub by: DecisionArgs,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct DecisionArgs {
    #[command(flatten)]
    pub target: TargetArgs,
    /// Name of the person who verifies, undoes or finishes the compensation.
    #[arg(long, value_name = "NAME", value_parser = parse_person_name)]
    pub who: String,
}

#[derive(Debug, Args)]
pub struct PredictPoseErrorsArgs {
    /// Estimate of axis errors, in the format of `trued run samba --json`.
    #[arg(value_name = "EST.json")]
    pub estimate: PathBuf,
    /// Table of poses with some of the columns x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,s_deg (axes without a column
    /// are at 0). The output repeats the poses and adds the errors of the tool tip and of the tool direction,
    /// in the table frame, with their standard uncertainties. Without this option: largest and mean error
    /// over the measured ranges of the axes.
    #[arg(long, value_name = "POSES.csv")]
    pub at: Option<PathBuf>,
    /// Machine file; without it, the built-in machine of the method of the estimate.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Pose at which the work zero is set, such as "X100 Z300 B0"; without it, the tip is at the origin of
    /// the table and the rotary axes are at 0. At this pose the error of the tip is zero; at all other poses
    /// tool-centre control (TCP) follows the workpiece with the nominal machine model.
    #[arg(long, value_name = "POSE")]
    pub zero: Option<String>,
    /// Set the work zero again at each position of the rotary axes, with the tip at the origin of the table.
    #[arg(long, conflicts_with = "zero")]
    pub without_tool_centre_control: bool,
    /// Also print the errors that remain after these parameters are corrected by their estimated values:
    /// symbols separated by commas, such as EX0C,EY0C, or `all`.
    #[arg(long, value_name = "SYMBOLS")]
    pub corrected: Option<String>,
    /// Allow poses outside the measured ranges of the axes.
    #[arg(long)]
    pub extrapolate: bool,
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Number of the run; `trued runs` lists the numbers.
    pub run: i64,
    /// Output folder; created if missing.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub to: PathBuf,
    /// Also write the readings as points in workpiece coordinates (of a touch: the centre of the stylus ball),
    /// computed with the nominal machine model.
    #[arg(long, value_enum)]
    pub frame: Option<ExportFrame>,
    /// Compute the points of --frame with the machine errors of this estimate.
    #[arg(long, value_name = "EST.json", requires = "frame")]
    pub with: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFrame {
    /// Frame of the table: the machine frame when all axes are at zero.
    Workpiece,
}

#[derive(Debug, Args)]
pub struct BackupArgs {
    /// Output file; it must not exist yet. A copy with the name `journal.sqlite` in its own folder can be
    /// used with --state.
    pub file: PathBuf,
}

/// A name that is not blank, without blanks around it.
fn parse_person_name(text: &str) -> Result<String, String> {
    let name = text.trim();
    if name.is_empty() { Err("give the name of a person".to_owned()) } else { Ok(name.to_owned()) }
}
