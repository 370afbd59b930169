//! What nobody can guess, and what is kept of it.

use sha2::{Digest, Sha256};

/// 256 bits from the operating system, in hexadecimal digits.
///
/// # Errors
/// It has none to give.
pub fn new() -> Result<String, getrandom::Error> {
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes)?;
    Ok(digits(&bytes))
}

/// As many bits as the secret has: no salt, no slow hash is needed against guessing.
pub fn sha256(secret: &str) -> String {
    digits(&Sha256::digest(secret.as_bytes()))
}

fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
