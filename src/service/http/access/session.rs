//! Sessions of the web page. The browser stores only a random number. The daemon stores the token of the session, for
//! at most [`SESSION_DURATION`] and while the token is valid.

use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use subtle::ConstantTimeEq;

use super::tokens::{Token, generate_secret};
use crate::service::lock;
use crate::store::sha256_text;

/// Duration of a session; after that, the user must sign in again.
pub const SESSION_DURATION: Duration = Duration::from_secs(12 * 3600);
/// Maximum number of sessions; a new one then replaces the oldest.
const MAX_SESSIONS: usize = 64;

/// A session of the web page.
struct Session {
    /// SHA-256 of the random number that the browser keeps.
    number_sha256: String,
    token: Token,
    started: Instant,
}

/// Open sessions, oldest first, in memory only: the end of the daemon ends them.
#[derive(Default)]
pub struct Sessions(Mutex<Vec<Session>>);

impl Sessions {
    fn lock_and_remove_expired(&self) -> MutexGuard<'_, Vec<Session>> {
        let mut all = lock(&self.0);
        all.retain(|session| session.started.elapsed() < SESSION_DURATION);
        all
    }

    /// Opens a session and returns the number that the browser keeps.
    ///
    /// # Errors
    /// The operating system provides no random numbers.
    pub fn open(&self, token: Token) -> Result<String, getrandom::Error> {
        let number = generate_secret()?;
        let session = Session { number_sha256: sha256_text(&number), token, started: Instant::now() };
        let mut all = self.lock_and_remove_expired();
        if all.len() >= MAX_SESSIONS {
            all.remove(0);
        }
        all.push(session);
        Ok(number)
    }

    /// Token of the session `number`; `None` if the session is unknown or has expired. Whether the token is revoked
    /// is not checked here.
    pub fn find_token(&self, number: &str) -> Option<Token> {
        let sha256 = sha256_text(number);
        let all = self.lock_and_remove_expired();
        let is = |session: &&Session| bool::from(session.number_sha256.as_bytes().ct_eq(sha256.as_bytes()));
        all.iter().find(is).map(|session| session.token.clone())
    }

    pub fn close(&self, number: &str) {
        let sha256 = sha256_text(number);
        self.lock_and_remove_expired().retain(|session| session.number_sha256 != sha256);
    }
}

#[cfg(test)]
mod tests {
    use super::super::roles::Role;
    use super::super::tokens::TokenStore;
    use super::*;

    #[test]
    fn oldest_session_is_replaced_and_logout_ends_a_session() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = TokenStore::in_folder(folder.path());
        tokens.add("tablet", Role::Viewer).unwrap();
        let token = tokens.read_all().unwrap().remove(0);
        let sessions = Sessions::default();
        let numbers: Vec<String> = (0..MAX_SESSIONS).map(|_| sessions.open(token.clone()).unwrap()).collect();
        assert_eq!(sessions.find_token(&numbers[0]), Some(token.clone()));
        sessions.open(token.clone()).unwrap();
        assert_eq!(sessions.find_token(&numbers[0]), None);
        assert_eq!(sessions.find_token(&numbers[1]), Some(token));
        sessions.close(&numbers[1]);
        assert_eq!(sessions.find_token(&numbers[1]), None);
        assert_eq!(sessions.find_token(""), None);
    }
}
