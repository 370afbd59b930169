//! Fuzzing of all parsers of external input. Each module fuzzes its own parsers; this module holds the shared part:
//! stored inputs, mutations of valid files, and a bound on the output.
//!
//! A normal test run uses the same few hundred inputs every time. With `TRUED_FUZZ_SECONDS` set, it uses new ones
//! for that time. A failure is written to `tests/data/fuzz/TARGET/` and replayed from then on.

use std::cell::Cell;
use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime};

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{Config, RngAlgorithm, TestError, TestRng, TestRunner};

const CASES_PER_ROUND: u32 = 300;
/// Tokens that often break parsers: numbers at and beyond the limits, other alphabets, unclosed brackets and
/// quotes, ends of lines and files.
const HOSTILE_TOKENS: [&str; 46] = [
    "NaN",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "1e999",
    "-1e-320",
    "5e-324",
    "-0",
    "+",
    "-",
    ".",
    "0x1",
    "4294967295",
    "4294967296",
    "-1",
    "18446744073709551616",
    "1.7976931348623157e308",
    "(",
    ")",
    "[",
    "]",
    "{",
    "}",
    "<",
    ">",
    "\"",
    "'",
    "\"\"\"",
    "%",
    "#",
    ";",
    ":",
    ",",
    "|",
    "=",
    "\n",
    "\r",
    "\r\n",
    "\0",
    "\u{feff}",
    "\u{2028}",
    "µ",
    "é\u{301}",
    "\u{1d7d9}",
    "😀",
];

/// One mutation of a file.
#[derive(Debug, Clone)]
enum Mutation {
    FlipBits(Index, u8),
    InsertToken(Index, Vec<u8>),
    InsertRepeatedByte(Index, u8, u16),
    Truncate(Index),
    DropLine(Index),
    DoubleLine(Index),
    SwapLines(Index, Index),
    /// Replaces a number.
    ReplaceNumber(Index, Vec<u8>),
}

/// Calls `read` with all stored inputs of `target`, then with mutated `samples`, with random sequences of
/// `words`, and with random bytes. `read` must not panic, and its return value, the size of its output in bytes, must
/// not exceed 64 times the input plus 64 KiB.
pub fn fuzz_parser(target: &str, samples: &[&[u8]], words: &[&str], read: impl Fn(&[u8]) -> usize) {
    let check = |input: &[u8]| {
        let made = read(input);
        let limit = 64 * input.len() + 65_536;
        assert!(made <= limit, "{made} bytes out of {}", input.len());
    };
    for file in stored_failures(target) {
        println!("{}", file.display());
        check(&std::fs::read(file).unwrap());
    }
    for sample in samples {
        check(sample);
    }
    let inputs = input_strategy(samples, words);
    match std::env::var("TRUED_FUZZ_SECONDS") {
        Err(_) => fuzz_round(target, 0, &inputs, check),
        Ok(seconds) => {
            let until = Instant::now() + Duration::from_secs(seconds.parse().unwrap());
            let epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
            let (first, mut seed) = (epoch.as_secs(), epoch.as_secs());
            while Instant::now() < until {
                fuzz_round(target, seed, &inputs, check);
                seed += 1;
            }
            println!("{target}: {} inputs, seeds from {first}", (seed - first) * u64::from(CASES_PER_ROUND));
        }
    }
}

fn failure_folder(target: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../data/fuzz").join(target)
}

fn stored_failures(target: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(failure_folder(target)).into_iter().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn fuzz_round(target: &str, seed: u64, inputs: &BoxedStrategy<Vec<u8>>, check: impl Fn(&[u8])) {
    let mut key = [0; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    let random = TestRng::from_seed(RngAlgorithm::ChaCha, &key);
    let config = Config { cases: CASES_PER_ROUND, failure_persistence: None, ..Config::default() };
    let longest = Cell::new(0);
    let ended = TestRunner::new_with_rng(config, random).run(inputs, |input| {
        longest.set(longest.get().max(input.len()));
        check(&input);
        Ok(())
    });
    match ended {
        Ok(()) => assert!(longest.get() > 100, "only short inputs"),
        Err(TestError::Fail(why, input)) => {
            std::fs::create_dir_all(failure_folder(target)).unwrap();
            let file = failure_folder(target).join(format!("found-{seed}"));
            std::fs::write(&file, &input).unwrap();
            let text = String::from_utf8_lossy(&input);
            panic!("{}: {why}\n{text:?}", file.display());
        }
        Err(TestError::Abort(why)) => panic!("{why}"),
    }
}

fn input_strategy(samples: &[&[u8]], words: &[&str]) -> BoxedStrategy<Vec<u8>> {
    let samples: Vec<Vec<u8>> = samples.iter().map(|sample| sample.to_vec()).collect();
    let spoilt = (select(samples), vec(mutation_strategy(), 1..12)).prop_map(|(mut text, spoils)| {
        for spoil in spoils {
            apply_mutation(spoil, &mut text);
        }
        text
    });
    let words: Vec<Vec<u8>> = words.iter().map(|word| word.as_bytes().to_vec()).collect();
    let word = prop_oneof![3 => select(words), 1 => token_strategy()];
    let soup = vec(word, 0..60).prop_map(|words| words.concat());
    let noise = vec(any::<u8>(), 0..400);
    prop_oneof![6 => spoilt, 3 => soup, 1 => noise].boxed()
}

fn token_strategy() -> impl Strategy<Value = Vec<u8>> {
    let digits = (1..500_usize).prop_map(|count| vec![b'9'; count]);
    let known = select(HOSTILE_TOKENS.to_vec()).prop_map(|token| token.as_bytes().to_vec());
    let number = any::<f64>().prop_map(|value| value.to_string().into_bytes());
    prop_oneof![6 => known, 1 => digits, 2 => number]
}

fn mutation_strategy() -> impl Strategy<Value = Mutation> {
    let at = any::<Index>;
    prop_oneof![
        (at(), any::<u8>()).prop_map(|(at, bits)| Mutation::FlipBits(at, bits)),
        (at(), token_strategy()).prop_map(|(at, token)| Mutation::InsertToken(at, token)),
        (at(), any::<u8>(), 1..3_000_u16).prop_map(|(at, b, n)| Mutation::InsertRepeatedByte(at, b, n)),
        at().prop_map(Mutation::Truncate),
        at().prop_map(Mutation::DropLine),
        at().prop_map(Mutation::DoubleLine),
        (at(), at()).prop_map(|(a, b)| Mutation::SwapLines(a, b)),
        (at(), token_strategy()).prop_map(|(at, token)| Mutation::ReplaceNumber(at, token)),
        (at(), token_strategy()).prop_map(|(at, token)| Mutation::ReplaceNumber(at, token)),
    ]
}

fn apply_mutation(mutation: Mutation, text: &mut Vec<u8>) {
    if text.is_empty() {
        return;
    }
    match mutation {
        Mutation::FlipBits(at, bits) => *at.get_mut(text) ^= bits,
        Mutation::InsertToken(at, token) => {
            let at = at.index(text.len());
            text.splice(at..at, token);
        }
        Mutation::InsertRepeatedByte(at, byte, count) => {
            let at = at.index(text.len());
            // Deeply nested brackets as well as very long lines.
            let byte = if byte % 2 == 0 { b"[({<"[usize::from(byte) / 2 % 4] } else { byte };
            text.splice(at..at, std::iter::repeat_n(byte, usize::from(count)));
        }
        Mutation::Truncate(at) => text.truncate(at.index(text.len())),
        Mutation::ReplaceNumber(at, token) => {
            let is_number = |byte: &u8| byte.is_ascii_digit() || b".+-".contains(byte);
            let (at, end) = (at.index(text.len()), text.len());
            let from = (at..end).find(|i| is_number(&text[*i])).unwrap_or(at);
            let to = (from..end).find(|i| !is_number(&text[*i])).unwrap_or(end);
            text.splice(from..to, token);
        }
        Mutation::DropLine(_) | Mutation::DoubleLine(_) | Mutation::SwapLines(..) => {
            let mut lines: Vec<Vec<u8>> = text.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
            apply_line_mutation(mutation, &mut lines);
            *text = lines.concat();
        }
    }
}

fn apply_line_mutation(spoil: Mutation, lines: &mut Vec<Vec<u8>>) {
    let count = lines.len();
    match spoil {
        Mutation::DropLine(at) => drop(lines.remove(at.index(count))),
        Mutation::DoubleLine(at) => lines.insert(at.index(count), lines[at.index(count)].clone()),
        Mutation::SwapLines(a, b) => lines.swap(a.index(count), b.index(count)),
        _ => {}
    }
}
