//! Content of a sensor's frame, as the machine file describes it: value, status and counter. Shared by all
//! sensors that send frames.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::encoder;
use super::field::{Field, Order};
use machine::record::reading::Flag;

/// Keys of `[sensor.….value]`: value = `offset_mm` + `scale_mm` × the number.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValueKeys {
    byte: u16,
    #[serde(default)]
    bit: u16,
    width: u16,
    order: Option<Order>,
    #[serde(default)]
    signed: bool,
    /// Size of one count, mm; negative if the sensor counts in the other direction.
    scale_mm: f64,
    #[serde(default)]
    offset_mm: f64,
    /// Numbers that are codes, not values.
    #[serde(default)]
    codes: Vec<CodeKeys>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct CodeKeys {
    is: i64,
    means: Means,
}

/// Keys of `[sensor.….counter]`: the counter increases by one with each sample, and wraps around.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CounterKeys {
    byte: u16,
    #[serde(default)]
    bit: u16,
    width: u16,
    order: Option<Order>,
}

/// Keys of `[sensor.….encoder_count]`: the count of a rotary encoder at the sample.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderCountKeys {
    byte: u16,
    #[serde(default)]
    bit: u16,
    width: u16,
    order: Option<Order>,
    /// Number of counts after which the count restarts; if absent, the capacity of its bits.
    round: Option<u64>,
}

/// Keys of `[[sensor.….status]]`: bits with a meaning that applies if they hold `is` (absent: any number
/// but zero).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatusKeys {
    byte: u16,
    #[serde(default)]
    bit: u16,
    #[serde(default = "one")]
    width: u16,
    order: Option<Order>,
    is: Option<i64>,
    means: Means,
}

fn one() -> u16 {
    1
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Means {
    /// No echo comes back from a surface.
    NoEcho,
    Range,
    Saturated,
    /// The value is an earlier one.
    Stale,
}

impl ValueKeys {
    fn place(&self) -> Field {
        let Self { byte, bit, width, signed, .. } = *self;
        Field { byte, bit, width, order: Order::Little, signed }
    }
}

impl CounterKeys {
    fn place(&self) -> Field {
        let Self { byte, bit, width, .. } = *self;
        Field { byte, bit, width, order: Order::Little, signed: false }
    }
}

impl EncoderCountKeys {
    fn place(&self) -> Field {
        let Self { byte, bit, width, .. } = *self;
        Field { byte, bit, width, order: Order::Little, signed: false }
    }
}

impl StatusKeys {
    fn place(&self) -> Field {
        let Self { byte, bit, width, .. } = *self;
        Field { byte, bit, width, order: Order::Little, signed: false }
    }
}

impl Means {
    pub fn flag(self) -> Flag {
        match self {
            Self::NoEcho | Self::Range => Flag::Range,
            Self::Saturated => Flag::Saturated,
            Self::Stale => Flag::Stale,
        }
    }
}

/// A frame layout that has passed the checks.
#[derive(Debug, Clone)]
pub struct Layout {
    value: Field,
    scale_mm: f64,
    offset_mm: f64,
    codes: Vec<(i128, Flag)>,
    counter: Option<Field>,
    /// Field of the encoder's count, and number of different counts.
    encoder: Option<(Field, u64)>,
    status: Vec<(Field, Option<i128>, Flag)>,
    /// Number of bytes that a frame must have.
    needs: usize,
}

/// Decoded content of a sensor's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decoded {
    /// Value in mm, or the reason why there is none.
    pub value: Result<f64, Flag>,
    pub counter: Option<u64>,
    /// Count of the rotary encoder, as a remainder (`encoder.rs`).
    pub encoder_count: Option<u32>,
}

impl Decoded {
    /// Replaces a value beyond the sensor's range by the flag `Range`.
    pub fn within(self, [least, greatest]: [f64; 2]) -> Self {
        let value = self.value.and_then(|mm| {
            if (least..=greatest).contains(&mm) { Ok(mm) } else { Err(Flag::Range) }
        });
        Self { value, ..self }
    }
}

/// Maximum width of a counter, bits: far more than any sensor has.
const WIDEST_COUNTER: u16 = 32;

impl Layout {
    /// Checks the layout of frames of `length` bytes; `order` applies to numbers without an order of their
    /// own.
    ///
    /// # Errors
    /// The layout is invalid; the message names the keys.
    pub fn new(
        value: ValueKeys,
        counter: Option<CounterKeys>,
        encoder: Option<EncoderCountKeys>,
        status: Vec<StatusKeys>,
        order: Option<Order>,
        length: usize,
    ) -> Result<Self, String> {
        let place = placed("value", value.place(), value.order.or(order))?;
        let codes = codes(&value, place)?;
        let counter = match counter {
            Some(keys) => Some(placed("counter", keys.place(), keys.order.or(order))?),
            None => None,
        };
        if let Some(field) = counter.filter(|counter| counter.width > WIDEST_COUNTER) {
            return Err(format!("`counter.width` is {}; {WIDEST_COUNTER} at most", field.width));
        }
        let encoder = encoder.map(|keys| encoder_field(&keys, order)).transpose()?;
        let says = status_words(&status, order)?;
        let named = [("value".to_owned(), place)].into_iter();
        let named = named.chain(counter.map(|counter| ("counter".to_owned(), counter)));
        let named = named.chain(encoder.map(|(field, _)| ("encoder_count".to_owned(), field)));
        let first =
            |at: usize, place: Field| !says.iter().take(at).any(|(other, ..)| *other == place);
        let words = status_names().zip(says.iter().map(|(field, ..)| *field)).enumerate();
        let words = words.filter(|(at, (_, field))| first(*at, *field)).map(|(_, named)| named);
        let needs = apart(named.chain(words), length)?;
        let ValueKeys { scale_mm, offset_mm, .. } = value;
        Ok(Self { value: place, scale_mm, offset_mm, codes, counter, encoder, status: says, needs })
    }

    /// Width of the counter in bits, if the layout has one.
    pub fn counter_width(&self) -> Option<u16> {
        self.counter.map(|counter| counter.width)
    }

    /// Number of counts after which the encoder's count restarts, if a frame holds it.
    pub fn encoder_round(&self) -> Option<u64> {
        self.encoder.map(|(_, round)| round)
    }

    /// # Errors
    /// The frame is too short for the layout.
    pub fn decode(&self, frame: &[u8]) -> Result<Decoded, Short> {
        let short = Short { needs: self.needs, came: frame.len() };
        let number = self.value.of(frame).ok_or(short)?;
        let mut flag = None;
        for (field, is, means) in &self.status {
            let found = field.of(frame).ok_or(short)?;
            if is.map_or(found != 0, |is| found == is) {
                flag = flag.or(Some(*means));
            }
        }
        let code = self.codes.iter().find(|(is, _)| *is == number).map(|(_, means)| *means);
        let counter = match self.counter {
            Some(field) => Some(field.of(frame).ok_or(short)? as u64),
            None => None,
        };
        let encoder_count = match self.encoder {
            Some((field, round)) => Some(encoder::wrapped(field.of(frame).ok_or(short)?, round)),
            None => None,
        };
        let value = match flag.or(code) {
            Some(flag) => Err(flag),
            None => Ok(self.offset_mm + self.scale_mm * number as f64),
        };
        Ok(Decoded { value, counter, encoder_count })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a frame of {came} bytes came where the layout needs {needs}")]
pub struct Short {
    pub needs: usize,
    pub came: usize,
}

fn encoder_field(keys: &EncoderCountKeys, order: Option<Order>) -> Result<(Field, u64), String> {
    let field = placed("encoder_count", keys.place(), keys.order.or(order))?;
    Ok((field, encoder::round(keys.round, field.width)?))
}

/// Returns field, number and meaning of each `status`.
fn status_words(
    status: &[StatusKeys],
    order: Option<Order>,
) -> Result<Vec<(Field, Option<i128>, Flag)>, String> {
    let mut says: Vec<(Field, Option<i128>, Flag)> = Vec::new();
    for (name, keys) in status_names().zip(status) {
        let field = placed(&name, keys.place(), keys.order.or(order))?;
        let is = keys.is.map(|is| possible(&name, is, field)).transpose()?;
        // Several entries may use the same bits, each with its own number.
        let same = says.iter().position(|(other, said, _)| {
            *other == field && said.is_none_or(|said| Some(said) == is)
        });
        if let Some(other) = same {
            return Err(format!(
                "`status {}` and `{name}` hold at once: they stand in the same bits; give each an `is` of \
                 its own, the one without behind the others",
                other + 1
            ));
        }
        says.push((field, is, keys.means.flag()));
    }
    Ok(says)
}

fn codes(value: &ValueKeys, place: Field) -> Result<Vec<(i128, Flag)>, String> {
    if value.scale_mm == 0.0 || !value.scale_mm.is_finite() {
        return Err(format!(
            "`value.scale_mm` is {}: every reading would be the same; it is the mm of one count, e.g. \
             0.001",
            value.scale_mm
        ));
    }
    if !value.offset_mm.is_finite() {
        return Err("`value.offset_mm` must be a finite number".to_owned());
    }
    let code = |code: &CodeKeys| Ok((possible("value", code.is, place)?, code.means.flag()));
    value.codes.iter().map(code).collect()
}

fn possible(name: &str, is: i64, place: Field) -> Result<i128, String> {
    let (least, greatest) = place.range();
    if (least..=greatest).contains(&i128::from(is)) {
        return Ok(i128::from(is));
    }
    let width = place.width;
    Err(format!("`{name}` can never be {is}: {width} bits hold {least} to {greatest}"))
}

fn status_names() -> impl Iterator<Item = String> {
    (1..).map(|number: u32| format!("status {number}"))
}

fn placed(name: &str, place: Field, order: Option<Order>) -> Result<Field, String> {
    place.check(name)?;
    match order {
        Some(order) => Ok(Field { order, ..place }),
        // Within one byte both orders are the same.
        None if place.bit + place.width <= 8 => Ok(place),
        None => Err(format!("`{name}` needs an `order`: `little` or `big`")),
    }
}

/// Checks that no bit is used twice and none is beyond `length`; returns the number of bytes that are
/// needed.
fn apart(named: impl Iterator<Item = (String, Field)>, length: usize) -> Result<usize, String> {
    let mut taken = BTreeMap::new();
    let mut needs = 0;
    for (name, field) in named {
        let end = field.end();
        if end > length {
            return Err(format!(
                "`{name}` reaches into byte {}; the frame has {length}, 0 to {}",
                end - 1,
                length.saturating_sub(1)
            ));
        }
        needs = needs.max(end);
        for (byte, bit) in field.bits() {
            if let Some(other) = taken.insert((byte, bit), name.clone()) {
                return Err(format!(
                    "`{other}` and `{name}` overlap at byte {byte}, bit {bit}: compare both with the \
                     sensor's manual"
                ));
            }
        }
    }
    Ok(needs)
}
