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

use super::{Good, Prepared, Request, Sample, SensorError, Tally};
use link::Talk;
use machine::record::reading::Flag;

pub const PREPARE: &str = "prepare";
pub const WATCH: &str = "watch";
const NONE: &str = "-";

pub fn take(count: u32) -> String {
    format!("take {count}")
}

pub fn prepared(Prepared { identity, rate_hz }: &Prepared) -> String {
    format!("{rate_hz} {}", identity.replace('\n', " "))
}

/// Numbers are written with full precision: reading them gives the same bits.
pub fn sample(Sample { t_s, value_mm, flag, missing, encoder_count }: &Sample) -> String {
    let value = value_mm.map_or(NONE.to_owned(), |mm| mm.to_string());
    let flag = Some(flag.as_str()).filter(|flag| !flag.is_empty()).unwrap_or(NONE);
    let count = encoder_count.map(|count| format!(" {count}")).unwrap_or_default();
    format!("{t_s} {value} {flag} {missing}{count}")
}

fn read_prepared(line: &str) -> Option<Prepared> {
    let (rate_hz, identity) = line.split_once(' ')?;
    Some(Prepared { identity: identity.to_owned(), rate_hz: rate_hz.parse().ok()? })
}

fn read_sample(line: &str) -> Option<Sample> {
    let mut parts = line.split(' ');
    let mut next = || parts.next();
    let (t_s, value, flag, missing) = (next()?, next()?, next()?, next()?);
    let flag = if flag == NONE { "" } else { flag };
    let value_mm = match value {
        NONE => None,
        mm => Some(mm.parse().ok()?),
    };
    Some(Sample {
        t_s: t_s.parse().ok()?,
        value_mm,
        flag: Flag::ALL.into_iter().find(|known| known.as_str() == flag)?,
        missing: missing.parse().ok()?,
        encoder_count: parts.next().map(str::parse).transpose().ok()?,
    })
}

/// Answers requests from a capture, until the handle is dropped.
pub async fn replay(talk: Talk, mut inbox: mpsc::Receiver<Request>) {
    let mut seen = Ok(None);
    while let Some(request) = inbox.recv().await {
        match request {
            Request::Captured(_) => {}
            Request::Prepare(answer) => {
                let first = lines(&talk, PREPARE, read_prepared).and_then(first);
                drop(answer.send(first));
            }
            Request::Take(count, answer) => {
                let samples = lines(&talk, &take(count), read_sample);
                let some =
                    samples.and_then(|all| if all.is_empty() { Err(ended()) } else { Ok(all) });
                drop(answer.send(some));
            }
            Request::Watch(good, act, stands) => {
                drop(stands.send(Ok(())));
                seen = watched(&talk, &good);
                if !matches!(seen, Ok(None)) {
                    act();
                }
            }
            // A capture has no counts.
            Request::Tally(answer) => drop(answer.send(Ok(Tally::default()))),
            Request::Current(answer) => drop(answer.send(Err(ended()))),
            Request::Rest(answer) => drop(answer.send(std::mem::replace(&mut seen, Ok(None)))),
        }
    }
}

/// Returns the first sample of the watch that was not good.
fn watched(talk: &Talk, good: &Good) -> Result<Option<Sample>, SensorError> {
    Ok(lines(talk, WATCH, read_sample)?.into_iter().find(|sample| !good(sample)))
}

fn first<T>(all: Vec<T>) -> Result<T, SensorError> {
    all.into_iter().next().ok_or_else(ended)
}

fn lines<T>(
    talk: &Talk,
    asked: &str,
    read: impl Fn(&str) -> Option<T>,
) -> Result<Vec<T>, SensorError> {
    let strange = |line: &String| SensorError::UnexpectedDevice {
        text: format!("the capture holds `{line}` for `{asked}`"),
        remedy: "it was cut or changed".to_owned(),
    };
    let said = talk.replayed(asked)?;
    said.iter().map(|line| read(line).ok_or_else(|| strange(line))).collect()
}

fn ended() -> SensorError {
    SensorError::UnexpectedDevice {
        text: "the capture holds no answer of the sensor here".to_owned(),
        remedy: "the run that was captured ended here".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_comes_back_to_the_last_bit() {
        for flag in Flag::ALL {
            for value_mm in [None, Some(-0.1 - 0.2), Some(1e-9), Some(-0.0)] {
                let one = Sample {
                    t_s: 1.0 / 3.0,
                    value_mm,
                    flag,
                    missing: 7,
                    encoder_count: value_mm.map(|_| u32::MAX),
                };
                assert_eq!(read_sample(&sample(&one)), Some(one));
            }
        }
        let said = Prepared { identity: "frames 181 on can0".to_owned(), rate_hz: 1e3 / 3.0 };
        assert_eq!(read_prepared(&prepared(&said)), Some(said));
        for spoilt in ["", "1.0", "1.0 2.0 - x", "1.0 2.0 odd 0", "1.0 - ", "1.0 2.0 - 0 x"] {
            assert_eq!(read_sample(spoilt), None, "{spoilt}");
        }
    }
}
