//! The tokens: created on this computer, shown once, stored only as SHA-256.
//!
//! They are in a separate file beside the journal, readable by the daemon's user only. The journal is copied, sent and
//! exported, so it must not contain secrets. A file is read without a database, and its metadata show whether it
//! has changed.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, fchown};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::roles::Role;
use crate::service::lock;

/// Maximum number of tokens.
const MAX_TOKENS: usize = 1000;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Token {
    pub name: String,
    pub role: Role,
    pub made: Timestamp,
    sha256: String,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TokenFile {
    trued_tokens: u32,
    tokens: Vec<Token>,
}

#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    #[error("{path}: {source}", path = path.display())]
    FileAccess { path: PathBuf, source: io::Error },
    #[error("{path}: {source}", path = path.display())]
    InvalidJson { path: PathBuf, source: serde_json::Error },
    #[error("{path} must belong to user {user}, but its owner cannot be changed", path = path.display())]
    OwnerChangeFailed { path: PathBuf, user: u32 },
    #[error("`{0}` is not a valid token name: use at most 40 letters, digits and . _ -")]
    InvalidName(String),
    #[error("the token `{0}` exists already")]
    DuplicateName(String),
    #[error("there is no token `{0}`")]
    UnknownName(String),
    #[error("the maximum of {MAX_TOKENS} tokens is reached")]
    TooManyTokens,
    #[error("the operating system provides no random numbers: {0}")]
    NoRandomNumbers(#[from] getrandom::Error),
}

impl TokenError {
    /// Remedy for the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            TokenError::FileAccess { source, .. } if source.kind() == ErrorKind::PermissionDenied => {
                "run the command as the daemon's user (`sudo -u trued trued token ...`), and make that user the \
                 owner of the files there (`chown trued`)"
            }
            TokenError::OwnerChangeFailed { .. } => {
                "run the command as the daemon's user: `sudo -u trued trued token ... --state /var/lib/trued`"
            }
            TokenError::FileAccess { .. } => {
                "check the disk and the owner of the folder, or choose another folder with --state"
            }
            TokenError::InvalidJson { .. } => "move the file away, then create the tokens again",
            Self::InvalidName(_) => "name the device or person that uses the token, for example `tablet-hall-2`",
            Self::DuplicateName(_) => "revoke that token first, or choose another name",
            Self::UnknownName(_) => "list the tokens with `trued token list`",
            Self::TooManyTokens => "revoke unused tokens",
            Self::NoRandomNumbers(_) => "try again when the computer has started up",
        }
    }
}

/// Metadata by which a changed file is detected: inode, length in bytes, modification time in s and ns.
type FileVersion = (u64, u64, i64, i64);

/// The file of the tokens, and its content when it was last read.
pub struct TokenStore {
    path: PathBuf,
    last_read_version_and_tokens: Mutex<(Option<FileVersion>, Vec<Token>)>,
}

impl TokenStore {
    /// Uses `tokens.json` in the folder of the journal.
    pub fn in_folder(journal_folder: &Path) -> Self {
        Self { path: journal_folder.join("tokens.json"), last_read_version_and_tokens: Mutex::default() }
    }

    /// Returns the tokens that are in the file now.
    ///
    /// # Errors
    /// The file exists and cannot be read.
    pub fn read_all(&self) -> Result<Vec<Token>, TokenError> {
        let mut read = lock(&self.last_read_version_and_tokens);
        let version = match fs::metadata(&self.path) {
            Ok(meta) => Some((meta.ino(), meta.len(), meta.mtime(), meta.mtime_nsec())),
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(source) => return Err(self.file_error(source)),
        };
        if read.0 != version {
            let tokens = match version {
                Some(_) => self.parse_token_file(&fs::read(&self.path).map_err(|error| self.file_error(error))?)?,
                None => Vec::new(),
            };
            *read = (version, tokens);
        }
        Ok(read.1.clone())
    }

    fn parse_token_file(&self, bytes: &[u8]) -> Result<Vec<Token>, TokenError> {
        let unreadable = |source| TokenError::InvalidJson { path: self.path.clone(), source };
        Ok(serde_json::from_slice::<TokenFile>(bytes).map_err(unreadable)?.tokens)
    }

    /// Returns the tokens of the last successful read.
    pub fn last_read_tokens(&self) -> Vec<Token> {
        lock(&self.last_read_version_and_tokens).1.clone()
    }

    /// Creates a token and returns its secret, which is stored nowhere.
    ///
    /// # Errors
    /// The name is invalid or exists already, the list is full, or the file cannot be written.
    pub fn add(&self, name: &str, role: Role) -> Result<String, TokenError> {
        let is_allowed = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        if name.is_empty() || name.len() > 40 || !name.chars().all(is_allowed) {
            return Err(TokenError::InvalidName(name.to_owned()));
        }
        let secret_text = format!("trued_{}", generate_secret()?);
        let sha256 = sha256_hex(&secret_text);
        let token = Token { name: name.to_owned(), role, made: Timestamp::now(), sha256 };
        self.change_tokens(|tokens| match tokens.iter().any(|known| known.name == name) {
            true => Err(TokenError::DuplicateName(name.to_owned())),
            false if tokens.len() >= MAX_TOKENS => Err(TokenError::TooManyTokens),
            false => {
                tokens.push(token);
                Ok(())
            }
        })?;
        Ok(secret_text)
    }

    /// # Errors
    /// There is no such token, or the file cannot be written.
    pub fn revoke(&self, name: &str) -> Result<(), TokenError> {
        self.change_tokens(|tokens| {
            let before = tokens.len();
            tokens.retain(|token| token.name != name);
            match tokens.len() < before {
                true => Ok(()),
                false => Err(TokenError::UnknownName(name.to_owned())),
            }
        })
    }

    /// Changes the file under a lock; the file is replaced as a whole or not at all.
    fn change_tokens(&self, change: impl FnOnce(&mut Vec<Token>) -> Result<(), TokenError>) -> Result<(), TokenError> {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let failed = |error| self.file_error(error);
        fs::create_dir_all(folder).map_err(failed)?;
        let lock = self.open_lock_file(folder)?;
        lock.lock().map_err(failed)?;
        let mut tokens = self.read_all()?;
        change(&mut tokens)?;
        let content = TokenFile { trued_tokens: 1, tokens };
        let unreadable = |source| TokenError::InvalidJson { path: self.path.clone(), source };
        let text = serde_json::to_string_pretty(&content).map_err(unreadable)?;
        self.replace_token_file(folder, &text)
    }

    fn open_lock_file(&self, folder: &Path) -> Result<File, TokenError> {
        let path = self.path.with_extension("lock");
        match create_private_file(&path) {
            Ok(made) => self.give_to_daemon_user(made, &path, folder),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                File::options().write(true).open(&path).map_err(|error| self.file_error(error))
            }
            Err(error) => Err(self.file_error(error)),
        }
    }

    fn replace_token_file(&self, folder: &Path, text: &str) -> Result<(), TokenError> {
        let (beside, failed) = (self.path.with_extension("new"), |error| self.file_error(error));
        match fs::remove_file(&beside) {
            // Left over from a process that died.
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(failed(error)),
        }
        let mut file = self.give_to_daemon_user(create_private_file(&beside).map_err(failed)?, &beside, folder)?;
        file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)?;
        fs::rename(&beside, &self.path).map_err(failed)?;
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)
    }

    /// Gives the new `file` at `path` to the daemon's user, whichever user creates it: the daemon could not read
    /// another user's file. The daemon's user is the owner of the tokens file, or else of the folder.
    fn give_to_daemon_user(&self, file: File, path: &Path, folder: &Path) -> Result<File, TokenError> {
        let failed = |error| self.file_error(error);
        let own = file.metadata().map_err(failed)?.uid();
        // A tokens file that belongs to root does not show which user the daemon runs as.
        let tokens = fs::metadata(&self.path).ok().filter(|tokens| tokens.uid() != 0);
        let owner = tokens.map_or_else(|| fs::metadata(folder), Ok).map_err(failed)?;
        let user = owner.uid();
        if own != user && fchown(&file, Some(user), Some(owner.gid())).is_err() {
            let _ = fs::remove_file(path);
            return Err(TokenError::OwnerChangeFailed { path: path.to_owned(), user });
        }
        Ok(file)
    }

    fn file_error(&self, source: io::Error) -> TokenError {
        TokenError::FileAccess { path: self.path.clone(), source }
    }
}

/// The token of `tokens` whose secret is `secret_text`. Every token is compared in full, so that the time is constant.
pub fn find_token(tokens: &[Token], secret_text: &str) -> Option<Token> {
    let sha256 = sha256_hex(secret_text);
    let mut found = None;
    for token in tokens {
        if bool::from(token.sha256.as_bytes().ct_eq(sha256.as_bytes())) {
            found = Some(token.clone());
        }
    }
    found
}

/// 256 bits from the operating system, in hexadecimal digits.
///
/// # Errors
/// The operating system provides no random numbers.
pub fn generate_secret() -> Result<String, getrandom::Error> {
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes)?;
    Ok(hex_digits(&bytes))
}

/// SHA-256 of a secret. The secret has 256 random bits, so that neither a salt nor a slow hash is needed.
pub fn sha256_hex(secret: &str) -> String {
    hex_digits(&Sha256::digest(secret.as_bytes()))
}

fn hex_digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Creates a new file that only this user can access; does not follow a symbolic link.
fn create_private_file(path: &Path) -> io::Result<File> {
    File::options().write(true).create_new(true).mode(0o600).open(path)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_token_is_shown_once_and_kept_as_its_hash() {
        let folder = tempfile::tempdir().unwrap();
        let (cli, daemon) = (TokenStore::in_folder(folder.path()), TokenStore::in_folder(folder.path()));
        assert_eq!(daemon.read_all().unwrap(), []);
        let secret_text = cli.add("tablet", Role::Operator).unwrap();
        assert_eq!(secret_text.len(), "trued_".len() + 64);
        assert_ne!(secret_text, cli.add("other", Role::Viewer).unwrap());
        let find = |secret_text: &str| find_token(&daemon.read_all().unwrap(), secret_text);
        let found = find(&secret_text).unwrap();
        assert_eq!((found.name.as_str(), found.role), ("tablet", Role::Operator));
        let file = folder.path().join("tokens.json");
        assert!(!fs::read_to_string(&file).unwrap().contains(&secret_text[6..]));
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        for wrong in ["", "trued_", &secret_text[..secret_text.len() - 1], &found.sha256] {
            assert_eq!(find(wrong), None, "{wrong}");
        }
        cli.revoke("tablet").unwrap();
        assert_eq!(find(&secret_text), None);
        assert_eq!(daemon.read_all().unwrap().len(), 1);
    }

    #[test]
    fn invalid_token_names_and_an_unreadable_token_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = TokenStore::in_folder(&folder.path().join("made"));
        for name in ["", "two words", "a\nb", &"n".repeat(41)] {
            assert!(matches!(tokens.add(name, Role::Viewer), Err(TokenError::InvalidName(_))), "{name}");
        }
        assert!(matches!(tokens.revoke("nobody"), Err(TokenError::UnknownName(_))));
        let secret_text = tokens.add("one", Role::Viewer).unwrap();
        assert!(matches!(tokens.add("one", Role::Viewer), Err(TokenError::DuplicateName(_))));
        // The file cannot be read: no token is valid, but the last read is remembered.
        assert!(find_token(&tokens.read_all().unwrap(), &secret_text).is_some());
        fs::write(folder.path().join("made/tokens.json"), "{").unwrap();
        assert!(matches!(tokens.read_all(), Err(TokenError::InvalidJson { .. })));
        assert!(find_token(&tokens.last_read_tokens(), &secret_text).is_some());
        assert!(matches!(tokens.add("two", Role::Viewer), Err(TokenError::InvalidJson { .. })));
    }

    /// Root may create a token in the daemon's folder, and the daemon can read it. Other users cannot change the owner
    /// of a file.
    #[test]
    fn token_file_has_the_owner_of_its_folder() {
        const DAEMON_UID: u32 = 65_534;
        let folder = tempfile::tempdir().unwrap();
        let made = |name: &str| fs::metadata(folder.path().join(name)).unwrap();
        if std::os::unix::fs::chown(folder.path(), Some(DAEMON_UID), Some(DAEMON_UID)).is_err() {
            println!("skipped: the test requires root");
            return;
        }
        let tokens = TokenStore::in_folder(folder.path());
        // Files that an earlier version left when it ran as root.
        for left in ["tokens.new", "tokens.json"] {
            fs::write(folder.path().join(left), r#"{"trued_tokens": 1, "tokens": []}"#).unwrap();
        }
        tokens.add("tablet", Role::Viewer).unwrap();
        for name in ["tokens.json", "tokens.lock"] {
            assert_eq!((made(name).uid(), made(name).mode() & 0o777), (DAEMON_UID, 0o600), "{name}");
        }
        tokens.revoke("tablet").unwrap();
        assert_eq!(made("tokens.json").uid(), DAEMON_UID);
    }
}
