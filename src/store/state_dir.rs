//! The state directory: location of the journal and of the locks.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// The state directory: `given` (from `--state`), else the first directory of `$STATE_DIRECTORY` (systemd),
/// else `$XDG_STATE_HOME/trued`, else `~/.local/state/trued` (XDG base directories). `None`: none of these is
/// known, and `--state` must be given.
pub fn state_dir(given: Option<&Path>) -> Option<PathBuf> {
    resolve_state_dir(given, |name| std::env::var_os(name))
}

fn resolve_state_dir(given: Option<&Path>, environment: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    // The XDG specification requires that a relative path is ignored.
    let absolute = |name| environment(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let systemd = || std::env::split_paths(&environment("STATE_DIRECTORY")?).next();
    given
        .map(Path::to_owned)
        .or_else(|| systemd().filter(|path| path.is_absolute()))
        .or_else(|| Some(absolute("XDG_STATE_HOME")?.join("trued")))
        .or_else(|| Some(absolute("HOME")?.join(".local/state/trued")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve_state_dir_with_variables(given: Option<&str>, variables: &[(&str, &str)]) -> Option<String> {
        let lookup =
            |name: &str| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| OsString::from(value));
        resolve_state_dir(given.map(Path::new), lookup).map(|path| path.display().to_string())
    }

    #[test]
    fn state_dir_is_the_option_else_from_the_environment_variables() {
        let all = [("STATE_DIRECTORY", "/s:/t"), ("XDG_STATE_HOME", "/x"), ("HOME", "/h")];
        assert_eq!(resolve_state_dir_with_variables(Some("here"), &all).unwrap(), "here");
        assert_eq!(resolve_state_dir_with_variables(None, &all).unwrap(), "/s");
        assert_eq!(resolve_state_dir_with_variables(None, &all[1..]).unwrap(), "/x/trued");
        assert_eq!(resolve_state_dir_with_variables(None, &all[2..]).unwrap(), "/h/.local/state/trued");
        assert_eq!(
            resolve_state_dir_with_variables(None, &[("XDG_STATE_HOME", "x"), ("HOME", "/h")]).unwrap(),
            "/h/.local/state/trued"
        );
        assert_eq!(resolve_state_dir_with_variables(None, &[("STATE_DIRECTORY", "")]), None);
    }
}
