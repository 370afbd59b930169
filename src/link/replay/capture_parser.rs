//! Reader of capture files.

use super::{CaptureError, CapturedReply};
use crate::capture::{CAPTURE_HEADER, LinkProtocol};

/// One link of a capture.
pub(super) struct CapturedLink {
    pub(super) link_number: u32,
    pub(super) protocol: LinkProtocol,
    pub(super) name: String,
    pub(super) transfers: Vec<Transfer>,
}

/// One transfer in one direction.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Transfer {
    Sent(Vec<u8>),
    Received(CapturedReply),
}

/// Parses the text of `file`.
///
/// # Errors
/// [`CaptureError::Undecodable`], with the number of the faulty line.
pub(super) fn parse_capture(file: &str, text: &str) -> Result<Vec<CapturedLink>, CaptureError> {
    let fault = |line: usize, why: &str| CaptureError::Undecodable { file: file.to_owned(), line, why: why.to_owned() };
    if text.lines().next() != Some(CAPTURE_HEADER) {
        return Err(fault(1, &format!("the file does not begin with `{CAPTURE_HEADER}`")));
    }
    if !text.ends_with('\n') {
        return Err(fault(text.lines().count(), "the last line has no line end"));
    }
    let mut links = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        if !line.starts_with('#') {
            parse_capture_line(line, &mut links).map_err(|why| fault(number, why))?;
        }
    }
    Ok(links)
}

/// Adds the content of one line to its link. A further `=` of a link adds nothing.
fn parse_capture_line(line: &str, links: &mut Vec<CapturedLink>) -> Result<(), &'static str> {
    let mut parts = line.splitn(4, ' ');
    let mut next = || parts.next().ok_or("the line has too few columns");
    let (seconds, number, mark, rest) = (next()?, next()?, next()?, next()?);
    let time_s: f64 = seconds.parse().map_err(|_| "the first column is not a time")?;
    let number: u32 = number.parse().map_err(|_| "the second column is not the number of a link")?;
    if !time_s.is_finite() {
        return Err("the first column is not a time");
    }
    let link = links.iter_mut().find(|link| link.link_number == number);
    match (mark, link) {
        ("=", Some(_)) => {}
        ("=", None) => {
            let (keyword, name) = rest.split_once(' ').ok_or("the link has no name")?;
            let protocol = LinkProtocol::ALL.into_iter().find(|protocol| protocol.keyword() == keyword);
            let protocol = protocol.ok_or("the fourth column does not begin with a known link protocol")?;
            links.push(CapturedLink { link_number: number, protocol, name: name.to_owned(), transfers: Vec::new() });
        }
        (">" | "<", None) => return Err("the link was not opened"),
        (">", Some(link)) => link.transfers.push(Transfer::Sent(unescape(rest)?)),
        ("<", Some(link)) => {
            link.transfers.push(Transfer::Received(CapturedReply { time_s, bytes: unescape(rest)? }));
        }
        _ => return Err("the third column is not `=`, `>` or `<`"),
    }
    Ok(())
}

/// Inverse of `escape_ascii`.
fn unescape(text: &str) -> Result<Vec<u8>, &'static str> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'\\' => parse_escape(&mut rest).ok_or("the content has an unknown escape")?,
            b' '..=b'~' => byte,
            _ => return Err("the content has an unprintable byte"),
        });
    }
    Ok(bytes)
}

/// Byte of an escape whose backslash is already read; `None`: unknown escape.
fn parse_escape(rest: &mut impl Iterator<Item = u8>) -> Option<u8> {
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
