//! What can be typed about runs that are stored, and estimates.

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
    /// Number of the run that is compared with it: differences are this one less the first.
    pub second: i64,
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct PredictArgs {
    /// An estimate of errors of the axes, as `trued run samba --json` prints it.
    #[arg(value_name = "EST.json")]
    pub estimate: PathBuf,
    /// Poses: a table with some of the columns x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,s_deg (axes without a column stand
    /// at 0). The errors of the tip and of the tool's direction are printed behind them, in the table frame, with
    /// their standard uncertainties. Without poses: largest and mean error over the
    /// ranges of the axes that the estimate was measured over.
    #[arg(long, value_name = "POSES.csv")]
    pub at: Option<PathBuf>,
    /// The machine file; without one, the built-in one of the estimate's method.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// The pose at which the work zero is set, such as "X100 Z300 B0"; without it, with the tip on the origin of
    /// the table and the rotary axes at 0. There the tip has no error; elsewhere tool-centre control follows the
    /// workpiece by the nominal machine.
    #[arg(long, value_name = "POSE")]
    pub zero: Option<String>,
    /// The work zero is set anew at each position of the rotary axes, with the tip on the origin of the table.
    #[arg(long, conflicts_with = "zero")]
    pub without_tool_centre_control: bool,
    /// Tell also what may be left after these errors are corrected by their estimated values: symbols with commas
    /// between, such as EX0C,EY0C, or `all`.
    #[arg(long, value_name = "SYMBOLS")]
    pub corrected: Option<String>,
    /// Predict outside the ranges of the axes that the estimate was measured over, too.
    #[arg(long)]
    pub extrapolate: bool,
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Number of the run, as `trued runs` lists it.
    pub run: i64,
    /// Folder to write to; made if missing.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub to: PathBuf,
    /// Write the readings as points of the workpiece, too, by the nominal machine.
    #[arg(long, value_enum)]
    pub frame: Option<Frame>,
    /// By the machine that this estimate has found.
    #[arg(long, value_name = "EST.json", requires = "frame")]
    pub with: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Frame {
    /// That of the table: the machine frame when all axes stand at zero.
    Workpiece,
}

#[derive(Debug, Args)]
pub struct BackupArgs {
    /// Never over a file that is there. As `journal.sqlite` in a folder of its own it serves with --state.
    pub file: PathBuf,
}
