//! Release builds contain the commit hash. Development builds do not, so that a commit does not cause a rebuild.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=.git/logs/HEAD");
    if std::env::var("PROFILE").as_deref() != Ok("release") {
        return;
    }
    let commit = Command::new("git").args(["rev-parse", "--short=12", "HEAD"]).output();
    // A source archive has no commit.
    if let Some(commit) = commit.ok().filter(|output| output.status.success()) {
        println!("cargo::rustc-env=TRUED_COMMIT={}", String::from_utf8_lossy(&commit.stdout).trim());
    }
}
