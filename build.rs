//! The version that `trued --version` prints, and the commit in the provenance of estimates. Release builds contain
//! the commit hash. Development builds do not, so that a commit does not cause a rebuild.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=.git/logs/HEAD");
    let is_release = std::env::var("PROFILE").as_deref() == Ok("release");
    let commit = is_release.then(head_commit).flatten();
    let build = match &commit {
        Some(commit) => commit,
        None if is_release => "source archive without commit",
        None => "development build",
    };
    println!("cargo::rustc-env=TRUED_VERSION={} ({build})", env!("CARGO_PKG_VERSION"));
    if let Some(commit) = commit {
        println!("cargo::rustc-env=TRUED_COMMIT={commit}");
    }
}

/// Hash of the last commit; `None`: a source archive has no commit.
fn head_commit() -> Option<String> {
    let output = Command::new("git").args(["rev-parse", "--short=12", "HEAD"]).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
