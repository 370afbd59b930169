//! Runs the Python scripts with which the benchmarks compare `trued`.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;

pub fn scipy_folder() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-scipy")
}

/// The python of a venv with scipy; the venv is created if it does not exist.
pub fn scipy_python() -> Result<PathBuf, Box<dyn Error>> {
    if let Some(python) = std::env::var_os("TRUED_BENCH_PYTHON") {
        std::fs::create_dir_all(scipy_folder())?;
        return Ok(python.into());
    }
    let python = scipy_folder().join("bin/python");
    if !python.exists() {
        run_and_read_stdout(Command::new("python3").args(["-m", "venv"]).arg(scipy_folder()))?;
    }
    if run_and_read_stdout(Command::new(&python).args(["-c", "import scipy"])).is_err() {
        run_and_read_stdout(Command::new(&python).args(["-m", "pip", "install", "--quiet", "numpy", "scipy"]))?;
    }
    Ok(python)
}

/// The numbers that the script of `command` prints; the first is its computing time, s.
pub fn run_and_read_numbers(command: &mut Command) -> Result<Vec<f64>, Box<dyn Error>> {
    let output = run_and_read_stdout(command)?;
    let mut numbers = Vec::new();
    for line in output.lines() {
        match line.strip_prefix('#') {
            Some(comment) => println!("scipy:{comment}"),
            None => numbers.push(line.trim().parse::<f64>()?),
        }
    }
    if numbers.is_empty() {
        return Err("the script printed nothing".into());
    }
    Ok(numbers)
}

fn run_and_read_stdout(command: &mut Command) -> Result<String, Box<dyn Error>> {
    let output = command.output().map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() {
        Ok(String::from_utf8(output.stdout)?)
    } else {
        Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)).into())
    }
}
