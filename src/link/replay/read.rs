//! Reader of capture files.

use super::Said;
use crate::capture::{HEAD, LinkProtocol};

/// One link of a capture.
pub(super) struct Track {
    pub(super) number: u32,
    pub(super) speech: LinkProtocol,
    pub(super) name: String,
    pub(super) passed: Vec<Transfer>,
}

/// One transfer in one direction.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Transfer {
    Sent(Vec<u8>),
    StreamRead(Said),
}

/// # Errors
/// The number of the faulty line (from 1), and the fault.
pub(super) fn tracks(text: &str) -> Result<Vec<Track>, (usize, String)> {
    let mut tracks: Vec<Track> = Vec::new();
    if text.lines().next() != Some(HEAD) {
        return Err((1, format!("it does not begin with `{HEAD}`")));
    }
    if !text.ends_with('\n') {
        return Err((text.lines().count(), "the line does not end".to_owned()));
    }
    for (line, number) in text.lines().zip(1..) {
        if !line.starts_with('#') {
            take(line, &mut tracks).map_err(|why| (number, why.to_owned()))?;
        }
    }
    Ok(tracks)
}

fn take(line: &str, tracks: &mut Vec<Track>) -> Result<(), &'static str> {
    let mut parts = line.splitn(4, ' ');
    let mut next = || parts.next().ok_or("it has too few parts");
    let (seconds, number, mark, rest) = (next()?, next()?, next()?, next()?);
    let at_s: f64 = seconds.parse().map_err(|_| "it begins with no time")?;
    let number: u32 = number.parse().map_err(|_| "it names no link's number")?;
    if !at_s.is_finite() {
        return Err("it begins with no time");
    }
    let track = tracks.iter_mut().find(|track| track.number == number);
    match (mark, track) {
        ("=", Some(_)) => {}
        ("=", None) => {
            let (speech, name) = rest.split_once(' ').ok_or("the link has no name")?;
            let known = LinkProtocol::ALL.into_iter().find(|known| known.name() == speech);
            let speech = known.ok_or("the link speaks in an unknown way")?;
            tracks.push(Track { number, speech, name: name.to_owned(), passed: Vec::new() });
        }
        (">" | "<", None) => return Err("the link was not opened"),
        (">", Some(track)) => track.passed.push(Transfer::Sent(unescape(rest)?)),
        ("<", Some(track)) => {
            track.passed.push(Transfer::StreamRead(Said { at_s, bytes: unescape(rest)? }));
        }
        _ => return Err("its mark is none of `=`, `>`, `<`"),
    }
    Ok(())
}

/// Inverse of `escape_ascii`.
fn unescape(text: &str) -> Result<Vec<u8>, &'static str> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'\\' => escaped(&mut rest).ok_or("it holds an unknown escape")?,
            b' '..=b'~' => byte,
            _ => return Err("it holds an unprintable byte"),
        });
    }
    Ok(bytes)
}

fn escaped(rest: &mut impl Iterator<Item = u8>) -> Option<u8> {
    Some(match rest.next()? {
        b'n' => b'\n',
        b'r' => b'\r',
        b't' => b'\t',
        byte @ (b'\\' | b'\'' | b'"') => byte,
        b'x' => {
            let digits = [rest.next()?, rest.next()?];
            let digits = std::str::from_utf8(&digits).ok()?;
            u8::from_str_radix(digits, 16).ok()?
        }
        _ => return None,
    })
}
