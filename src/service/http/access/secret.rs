//! Random secrets, and their hashes.

use sha2::{Digest, Sha256};

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
