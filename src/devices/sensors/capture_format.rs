//! Format of a capture: requests to a sensor and its answers, as lines; and the replay of a capture in
//! place of a sensor.
//!
//! ```text
//! > take 2
//! < 12.0310521 -0.41236 - 0
//! < 12.0320519 - range 1
//! ```
//!
//! Columns of a sample: time, s; distance, mm; flag; number of samples missing before it; the encoder's
//! count, if the sample has one.

use tokio::sync::mpsc;

use super::{Sample, SampleCounters, SamplePredicate, SensorError, SensorInfo, SensorRequest};
use link::SensorRequestCapture;
use machine::record::reading::ReadingFlag;

/// Request of a capture; its reply is the line of [`info_line`].
pub const PREPARE_REQUEST: &str = "prepare";
/// Request of a capture; its replies are all samples of the watch.
pub const WATCH_REQUEST: &str = "watch";
/// Column of a sample without a value, or without a flag.
const EMPTY_COLUMN: &str = "-";

/// Request of a capture that reads `count` samples.
pub fn read_request_line(count: u32) -> String {
    format!("take {count}")
}

/// Line of the reply to [`PREPARE_REQUEST`]: sample rate in Hz, then the identity.
pub fn info_line(SensorInfo { identity, sample_rate_hz }: &SensorInfo) -> String {
    format!("{sample_rate_hz} {}", identity.replace('\n', " "))
}

/// Line of a sample in the capture. Numbers are written with full precision: parsing them gives the same bits.
pub fn sample_line(
    Sample { received_s, value_mm, flag, lost_before_count: missing_count, encoder_count }: &Sample,
) -> String {
    let value = value_mm.map_or(EMPTY_COLUMN.to_owned(), |mm| mm.to_string());
    let flag = Some(flag.as_str()).filter(|flag| !flag.is_empty()).unwrap_or(EMPTY_COLUMN);
    let count = encoder_count.map(|count| format!(" {count}")).unwrap_or_default();
    format!("{received_s} {value} {flag} {missing_count}{count}")
}

fn parse_info(line: &str) -> Option<SensorInfo> {
    let (rate_hz, identity) = line.split_once(' ')?;
    Some(SensorInfo { identity: identity.to_owned(), sample_rate_hz: rate_hz.parse().ok()? })
}

fn parse_sample(line: &str) -> Option<Sample> {
    let mut parts = line.split(' ');
    let mut next = || parts.next();
    let (t_s, value, flag, missing) = (next()?, next()?, next()?, next()?);
    let flag = if flag == EMPTY_COLUMN { "" } else { flag };
    let value_mm = match value {
        EMPTY_COLUMN => None,
        mm => Some(mm.parse().ok()?),
    };
    Some(Sample {
        received_s: t_s.parse().ok()?,
        value_mm,
        flag: ReadingFlag::ALL.into_iter().find(|known| known.as_str() == flag)?,
        lost_before_count: missing.parse().ok()?,
        encoder_count: parts.next().map(str::parse).transpose().ok()?,
    })
}

/// Answers requests from a capture, until the handle is dropped. A sample for display gives an error, and all counts
/// are 0.
pub async fn replay_capture(capture: SensorRequestCapture, mut inbox: mpsc::Receiver<SensorRequest>) {
    let mut rejected = Ok(None);
    while let Some(request) = inbox.recv().await {
        match request {
            SensorRequest::StartCapture(_) => {}
            SensorRequest::Prepare(reply) => {
                let info =
                    parse_captured_reply(&capture, PREPARE_REQUEST, parse_info).and_then(first_or_exhausted_error);
                drop(reply.send(info));
            }
            SensorRequest::ReadSamples(count, reply) => {
                let samples = parse_captured_reply(&capture, &read_request_line(count), parse_sample);
                let non_empty =
                    samples.and_then(|all| if all.is_empty() { Err(capture_exhausted_error()) } else { Ok(all) });
                drop(reply.send(non_empty));
            }
            SensorRequest::Watch(is_good, on_rejection, started) => {
                drop(started.send(Ok(())));
                rejected = first_rejected_sample(&capture, &is_good);
                if !matches!(rejected, Ok(None)) {
                    on_rejection();
                }
            }
            // A capture has no counts.
            SensorRequest::Counters(reply) => drop(reply.send(Ok(SampleCounters::default()))),
            SensorRequest::SampleForDisplay(reply) => drop(reply.send(Err(capture_exhausted_error()))),
            SensorRequest::EndWatch(reply) => drop(reply.send(std::mem::replace(&mut rejected, Ok(None)))),
        }
    }
}

/// Returns the first sample of the watch that was not good; `None` if all were good.
fn first_rejected_sample(
    capture: &SensorRequestCapture,
    is_good: &SamplePredicate,
) -> Result<Option<Sample>, SensorError> {
    Ok(parse_captured_reply(capture, WATCH_REQUEST, parse_sample)?.into_iter().find(|sample| !is_good(sample)))
}

fn first_or_exhausted_error<T>(all: Vec<T>) -> Result<T, SensorError> {
    all.into_iter().next().ok_or_else(capture_exhausted_error)
}

/// Parses all lines of the captured reply to `request`; an error if the capture has another request at this place, or
/// if a line is unreadable.
fn parse_captured_reply<T>(
    capture: &SensorRequestCapture,
    request: &str,
    parse_line: impl Fn(&str) -> Option<T>,
) -> Result<Vec<T>, SensorError> {
    let unreadable = |line: &String| SensorError::InvalidData {
        text: format!("the capture has the unreadable line `{line}` for the request `{request}`"),
        remedy: "use an unchanged capture: this one was cut or changed".to_owned(),
    };
    let reply = capture.captured_replies_to(request)?;
    reply.iter().map(|line| parse_line(line).ok_or_else(|| unreadable(line))).collect()
}

fn capture_exhausted_error() -> SensorError {
    SensorError::InvalidData {
        text: "the capture has no further reply of the sensor".to_owned(),
        remedy: "use a capture of a longer run: this one ends here".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sample_line_is_parsed_back_bit_for_bit() {
        for flag in ReadingFlag::ALL {
            for value_mm in [None, Some(-0.1 - 0.2), Some(1e-9), Some(-0.0)] {
                let one = Sample {
                    received_s: 1.0 / 3.0,
                    value_mm,
                    flag,
                    lost_before_count: 7,
                    encoder_count: value_mm.map(|_| u32::MAX),
                };
                assert_eq!(parse_sample(&sample_line(&one)), Some(one));
            }
        }
        let reply = SensorInfo { identity: "frames 181 on can0".to_owned(), sample_rate_hz: 1e3 / 3.0 };
        assert_eq!(parse_info(&info_line(&reply)), Some(reply));
        for spoilt in ["", "1.0", "1.0 2.0 - x", "1.0 2.0 odd 0", "1.0 - ", "1.0 2.0 - 0 x"] {
            assert_eq!(parse_sample(spoilt), None, "{spoilt}");
        }
    }
}
