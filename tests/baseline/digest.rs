//! Compares long output with a stored digest of it.
//!
//! A digest has one row for each block of lines: its first line, SHA-256 (8 bytes) of the text with `#` in place of
//! each number, the count of numbers, their weighted sum and the sum of their weighted magnitudes. Text and
//! structure must be equal, the weighted sums within 1e-11 of the sum of magnitudes. In a block of readings that is
//! less than 1 nm of a single coordinate.

use std::fs;
use std::path::PathBuf;

use sha2::{Digest as _, Sha256};

use super::compare::{load_or_write_baseline, number_and_text_tokens};

const LINES_PER_BLOCK: usize = 64;
const RELATIVE_SUM_TOLERANCE: f64 = 1e-11;

/// Compares the digest of `actual` with the stored file `name`, or writes the file.
pub fn check_digest(name: &str, actual: &str) {
    let digest = Digest::compute(actual);
    let Some(stored) = load_or_write_baseline(name, &digest.to_stored_text()) else { return };
    let stored = Digest::parse_stored(&stored);
    let mut differences: Vec<String> = Vec::new();
    if stored.line_count != digest.line_count {
        differences.push(format!("  stored {} lines, now {}", stored.line_count, digest.line_count));
    }
    for (stored, actual) in stored.blocks.iter().zip(&digest.blocks) {
        let last = actual.first_line_number + LINES_PER_BLOCK - 1;
        let lines = format!("  lines {} to {last}", actual.first_line_number);
        if stored.text_hash != actual.text_hash || stored.number_count != actual.number_count {
            differences.push(format!(
                "{lines}: text differs; stored {} numbers and SHA-256 {}, now {} and {}",
                stored.number_count, stored.text_hash, actual.number_count, actual.text_hash
            ));
        } else if (stored.weighted_sum - actual.weighted_sum).abs()
            > RELATIVE_SUM_TOLERANCE * stored.weighted_magnitude_sum
        {
            let (a, b) = (stored.weighted_sum, actual.weighted_sum);
            differences.push(format!("{lines}: numbers differ; stored sum {a:?}, now {b:?}"));
        }
    }
    if !differences.is_empty() {
        let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("baseline").join(name);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(&file, actual).unwrap();
        panic!(
            "tests/data/baseline/{name}: {} differences\n{}\n  the whole text of now: {}\n",
            differences.len(),
            differences[..differences.len().min(20)].join("\n"),
            file.display()
        );
    }
}

struct Digest {
    line_count: usize,
    blocks: Vec<DigestBlock>,
}

struct DigestBlock {
    first_line_number: usize,
    text_hash: String,
    number_count: usize,
    weighted_sum: f64,
    weighted_magnitude_sum: f64,
}

impl Digest {
    fn compute(text: &str) -> Self {
        let lines: Vec<&str> = text.lines().collect();
        let blocks = lines.chunks(LINES_PER_BLOCK).enumerate();
        let blocks = blocks.map(|(index, lines)| DigestBlock::from_lines(1 + index * LINES_PER_BLOCK, lines));
        Self { line_count: lines.len(), blocks: blocks.collect() }
    }

    fn to_stored_text(&self) -> String {
        let rows = self.blocks.iter().map(|block| {
            let DigestBlock {
                first_line_number: first_line,
                text_hash: structure,
                number_count: numbers,
                weighted_sum: sum,
                weighted_magnitude_sum: magnitude,
            } = block;
            format!("{first_line} {structure} {numbers} {sum:?} {magnitude:?}\n")
        });
        format!("{} lines\n{}", self.line_count, rows.collect::<String>())
    }

    fn parse_stored(text: &str) -> Self {
        let (head, rows) = text.split_once(" lines\n").unwrap();
        let block = |row: &str| {
            let mut parts = row.split(' ');
            let mut next = || parts.next().unwrap();
            DigestBlock {
                first_line_number: next().parse().unwrap(),
                text_hash: next().to_owned(),
                number_count: next().parse().unwrap(),
                weighted_sum: next().parse().unwrap(),
                weighted_magnitude_sum: next().parse().unwrap(),
            }
        };
        Self { line_count: head.parse().unwrap(), blocks: rows.lines().map(block).collect() }
    }
}

impl DigestBlock {
    fn from_lines(first_line: usize, lines: &[&str]) -> Self {
        let mut hash = Sha256::new();
        let (mut numbers, mut sum, mut magnitude) = (0, 0.0, 0.0);
        for line in lines {
            for token in number_and_text_tokens(line) {
                let number = token.text.parse::<f64>().ok().filter(|number| number.is_finite());
                match number.filter(|_| token.is_number) {
                    Some(number) => {
                        hash.update("#");
                        // A weight between 1 and 2, different for each number of a block, so that an exchange of
                        // numbers is detected.
                        let weight = 1.0 + (numbers as f64 * 0.618_033_988_749_894_9).fract();
                        sum += weight * number;
                        magnitude += weight * number.abs();
                        numbers += 1;
                    }
                    None => hash.update(token.text),
                }
            }
            hash.update("\n");
        }
        let structure = hash.finalize()[..8].iter().map(|byte| format!("{byte:02x}")).collect();
        Self {
            first_line_number: first_line,
            text_hash: structure,
            number_count: numbers,
            weighted_sum: sum,
            weighted_magnitude_sum: magnitude,
        }
    }
}
