//! The tokens: created on this computer, shown once, stored only as SHA-256.
//!
//! They are in a separate file beside the journal, readable by the daemon's user only. The journal is copied, sent and
//! exported, so it must not contain secrets. A file is read without a database, and its metadata show whether it
//! has changed.

use std::path::Path;
use std::sync::Mutex;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use subtle::ConstantTimeEq;

use super::roles::Role;
use crate::service::lock;
use crate::store::{FileVersion, StateFile, StateFileError, sha256_text};

/// Maximum number of tokens.
const MAX_TOKENS: usize = 1000;

/// A token without its secret, as `tokens.json` contains it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Token {
    /// Unique name of the device or person that uses the token; it is no secret.
    pub name: String,
    pub role: Role,
    /// Time of creation.
    pub made: Timestamp,
    /// SHA-256 of the secret. The secret has 256 random bits, so that neither a salt nor a slow hash is needed.
    sha256: String,
}

/// Content of `tokens.json`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TokenFile {
    /// Version of the file format: 1. Not checked on reading.
    trued_tokens: u32,
    tokens: Vec<Token>,
}

#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    #[error(transparent)]
    File(#[from] StateFileError),
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
            Self::File(error) => error.remedy(),
            Self::InvalidName(_) => "name the device or person that uses the token, for example `tablet-hall-2`",
            Self::DuplicateName(_) => "revoke that token first, or choose another name",
            Self::UnknownName(_) => "list the tokens with `trued token list`",
            Self::TooManyTokens => "revoke unused tokens",
            Self::NoRandomNumbers(_) => "try again when the computer has started up",
        }
    }
}

/// The file of the tokens, and its content when it was last read.
pub struct TokenStore {
    file: StateFile,
    /// Version of the file (`None`: no file) and its tokens at the last successful read.
    last_read_version_and_tokens: Mutex<(Option<FileVersion>, Vec<Token>)>,
}

impl TokenStore {
    /// Uses `tokens.json` in the folder of the journal.
    pub fn in_folder(journal_folder: &Path) -> Self {
        Self { file: StateFile::new(journal_folder, "tokens.json"), last_read_version_and_tokens: Mutex::default() }
    }

    /// Returns the tokens that are in the file now; the file is read only if it has changed. Without a file there are
    /// none.
    ///
    /// # Errors
    /// The file exists and cannot be read.
    pub fn read_all(&self) -> Result<Vec<Token>, TokenError> {
        let mut read = lock(&self.last_read_version_and_tokens);
        let version = self.file.version()?;
        if read.0 != version {
            let content: Option<TokenFile> = self.file.read()?;
            *read = (version, content.map_or_else(Vec::new, |content| content.tokens));
        }
        Ok(read.1.clone())
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
        let sha256 = sha256_text(&secret_text);
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

    /// Removes the token `name` from the file; sessions that were opened with it are no longer valid.
    ///
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
        let _lock = self.file.lock()?;
        let mut tokens = self.read_all()?;
        change(&mut tokens)?;
        Ok(self.file.replace(&TokenFile { trued_tokens: 1, tokens })?)
    }
}

/// The token of `tokens` whose secret is `secret_text`. Every token is compared in full, so that the time is constant.
pub fn find_token(tokens: &[Token], secret_text: &str) -> Option<Token> {
    let sha256 = sha256_text(secret_text);
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
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::{MetadataExt, PermissionsExt};

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
        assert!(matches!(tokens.read_all(), Err(TokenError::File(StateFileError::InvalidJson { .. }))));
        assert!(find_token(&tokens.last_read_tokens(), &secret_text).is_some());
        assert!(matches!(tokens.add("two", Role::Viewer), Err(TokenError::File(StateFileError::InvalidJson { .. }))));
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
