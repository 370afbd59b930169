//! Replaces output that depends on wall time or on the computer.
//!
//! | output | field | in its place |
//! |---|---|---|
//! | report, `trued show`, HTTP | an instant: `2026-07-01T12:00:00.123Z`, `2026-07-01 14:00:00 CEST` | `TIMESTAMP_PLACEHOLDER` |
//! | `trued run`, standard error | the line `captured to FILE` | left out |
//! | `trued watch --json` | `t_s`: wall time of a sample | left out |
//! | capture | see `capture.rs` | |
//! | Modbus server | input register 0, `heartbeat` | 0 |
//! | HTTP, report, estimate | SHA-256 of plan, readings, estimate, machine file (last bits, comments) | `SHA256` |
//! | HTTP `/metrics` | values: counts and seconds of the process; the order of labels | left out; sorted |
//!
//! Readings, plans and programs contain no such output.

pub const TIMESTAMP_PLACEHOLDER: &str = "INSTANT";

/// `text` with each RFC 3339 instant and each local time replaced.
pub fn replace_timestamps(text: &str) -> String {
    const TIMESTAMP_PATTERN: &[u8] = b"0000-00-00T00:00:00";
    let bytes = text.as_bytes();
    let (mut result, mut from, mut at) = (String::new(), 0, 0);
    while at + TIMESTAMP_PATTERN.len() <= bytes.len() {
        let is_instant = TIMESTAMP_PATTERN.iter().zip(&bytes[at..]).all(|(pattern, byte)| match pattern {
            b'0' => byte.is_ascii_digit(),
            b'T' => matches!(byte, b'T' | b' '),
            separator => byte == separator,
        });
        if !is_instant {
            at += 1;
            continue;
        }
        result += &text[from..at];
        result += TIMESTAMP_PLACEHOLDER;
        at += TIMESTAMP_PATTERN.len();
        at += bytes[at..].iter().take_while(|&&byte| byte == b'.' || byte.is_ascii_digit()).count();
        at += usize::from(bytes.get(at) == Some(&b'Z'));
        // The zone of a local time, such as ` UTC`.
        let zone = bytes[at..].iter().skip(1).take_while(|&&byte| byte.is_ascii_uppercase() || byte == b'+').count();
        at += if bytes.get(at) == Some(&b' ') && zone > 0 { 1 + zone } else { 0 };
        from = at;
    }
    result + &text[from..]
}

/// `text` with each SHA-256 replaced.
pub fn replace_hashes(text: &str) -> String {
    const SHA256_HEX_DIGIT_COUNT: usize = 64;
    let is_hexadecimal =
        |word: &str| word.len() == SHA256_HEX_DIGIT_COUNT && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    let words = text.split_inclusive(|letter: char| !letter.is_ascii_alphanumeric());
    let replaced = words.map(|word| {
        let hash = word.trim_end_matches(|letter: char| !letter.is_ascii_alphanumeric());
        match is_hexadecimal(hash) {
            true => format!("SHA256{}", &word[hash.len()..]),
            false => word.to_owned(),
        }
    });
    replaced.collect()
}

/// `text` without the lines that start with one of `beginnings`.
pub fn remove_lines_with_prefixes(text: &str, beginnings: &[&str]) -> String {
    let kept = text.lines().filter(|line| !beginnings.iter().any(|begin| line.starts_with(begin)));
    kept.map(|line| format!("{line}\n")).collect()
}
