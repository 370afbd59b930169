//! Arguments for stored runs and estimates.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

#[derive(Debug, Args)]
pub struct RunsArgs {
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct ShowArgs {
    /// Number of the run, as `trued runs` lists it.
    pub run: i64,
    #[arg(long)]
    pub json: bool,
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Number of a run, as `trued runs` lists it.
    pub first: i64,
    /// Number of the run to compare with it; differences are this run minus the first.
    pub second: i64,
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct PredictArgs {
    /// An estimate of axis errors, as `trued run samba --json` prints it.
    #[arg(value_name = "EST.json")]
    pub estimate: PathBuf,
    /// Poses: a table with some of the columns x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,s_deg (axes without a column
    /// are at 0). The errors of the tip and of the tool's direction are printed after them, in the table frame,
    /// with their standard uncertainties. Without poses: largest and mean error over the ranges of the axes
    /// that the estimate was measured over.
    #[arg(long, value_name = "POSES.csv")]
    pub at: Option<PathBuf>,
    /// The machine file; without one, the built-in one of the estimate's method.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Pose at which the work zero is set, such as "X100 Z300 B0"; without it, with the tip on the origin of
    /// the table and the rotary axes at 0. At this pose the tip has no error; elsewhere tool-centre control
    /// follows the workpiece by the nominal machine.
    #[arg(long, value_name = "POSE")]
    pub zero: Option<String>,
    /// Set the work zero again at each position of the rotary axes, with the tip on the origin of the table.
    #[arg(long, conflicts_with = "zero")]
    pub without_tool_centre_control: bool,
    /// Also print the errors that may remain after these errors are corrected by their estimated values:
    /// symbols separated by commas, such as EX0C,EY0C, or `all`.
    #[arg(long, value_name = "SYMBOLS")]
    pub corrected: Option<String>,
    /// Also predict outside the ranges of the axes that the estimate was measured over.
    #[arg(long)]
    pub extrapolate: bool,
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Number of the run, as `trued runs` lists it.
    pub run: i64,
    /// Output folder; created if missing.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub to: PathBuf,
    /// Also write the readings as points of the workpiece, by the nominal machine.
    #[arg(long, value_enum)]
    pub frame: Option<Frame>,
    /// Compute the points by the machine of this estimate.
    #[arg(long, value_name = "EST.json", requires = "frame")]
    pub with: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Frame {
    /// Frame of the table: the machine frame when all axes are at zero.
    Workpiece,
}

#[derive(Debug, Args)]
pub struct BackupArgs {
    /// Output file, which must not exist. As `journal.sqlite` in a folder of its own it can be used with
    /// --state.
    pub file: PathBuf,
}
