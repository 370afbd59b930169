//! Content of a sensor's frame, as the machine file describes it: value, status and counter. Shared by all
//! sensors that send frames.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::bit_field::{BitField, Endianness};
use super::encoder_count;
use super::sample_layout::{DecodedSample, InvalidReason, NumberLocation, SampleLayout, check_scale};
use machine::record::reading::ReadingFlag;

/// Keys of `[sensor.….value]`: value = `offset_mm` + `scale_mm` × the number; bytes and bits count from 0.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameValueKeys {
    byte: u16,
    /// Number of bits below the number, in its first byte (little-endian) or its last byte (big-endian).
    #[serde(default)]
    bit: u16,
    /// Width of the number, bits.
    width: u16,
    /// Byte order; if absent, that of the whole frame.
    order: Option<Endianness>,
    #[serde(default)]
    signed: bool,
    /// Size of one count, mm; negative if the sensor counts in the other direction.
    scale_mm: f64,
    #[serde(default)]
    offset_mm: f64,
    /// Numbers that are codes, not values.
    #[serde(default)]
    codes: Vec<FrameCodeKeys>,
}

/// Keys of a code: while the value has the number `is`, it is invalid for the reason `means`.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameCodeKeys {
    /// Number in the field, before scale and offset.
    is: i64,
    means: InvalidReason,
}

/// Keys of `[sensor.….counter]`: the counter increases by one with each sample, and wraps around; bytes and bits count
/// from 0.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameCounterKeys {
    byte: u16,
    /// Number of bits below the number, in its first byte (little-endian) or its last byte (big-endian).
    #[serde(default)]
    bit: u16,
    /// Width of the number, bits.
    width: u16,
    /// Byte order; if absent, that of the whole frame.
    order: Option<Endianness>,
}

/// Keys of `[sensor.….encoder_count]`: the count of a rotary encoder at the sample; bytes and bits count from 0.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameEncoderKeys {
    byte: u16,
    /// Number of bits below the number, in its first byte (little-endian) or its last byte (big-endian).
    #[serde(default)]
    bit: u16,
    /// Width of the number, bits.
    width: u16,
    /// Byte order; if absent, that of the whole frame.
    order: Option<Endianness>,
    /// Number of counts after which the count restarts; if absent, the capacity of its bits.
    round: Option<u64>,
}

/// Keys of `[[sensor.….status]]`: bits that mark the value as invalid while they hold the number `is`, or any number
/// but zero if `is` is absent.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameStatusKeys {
    byte: u16,
    /// Number of bits below the number, in its first byte (little-endian) or its last byte (big-endian).
    #[serde(default)]
    bit: u16,
    /// Width of the number, bits.
    #[serde(default = "default_width")]
    width: u16,
    /// Byte order; if absent, that of the whole frame.
    order: Option<Endianness>,
    is: Option<i64>,
    means: InvalidReason,
}

fn default_width() -> u16 {
    1
}

/// Layout of a frame that has passed the checks.
#[derive(Debug, Clone)]
pub struct FrameLayout {
    pub sample_layout: SampleLayout<BitField>,
    /// Number of bytes up to the end of the last field; a shorter frame is an error, a longer one is not.
    required_bytes: usize,
}

/// Maximum width of a counter, bits; a wider one is refused.
const MAX_COUNTER_BITS: u16 = 32;

/// Condition that a field holds the number; `None`: any number but zero. A value is invalid if the condition is met.
type FieldCondition = (BitField, Option<i128>);

impl NumberLocation for BitField {
    type Data<'d> = &'d [u8];
    type Error = FrameTooShort;
    type Condition = FieldCondition;

    fn read_number(self, frame: &[u8]) -> Result<f64, FrameTooShort> {
        self.read_integer(frame).map(|number| number as f64)
    }

    fn read_integer(self, frame: &[u8]) -> Result<i128, FrameTooShort> {
        self.extract(frame)
            .ok_or(FrameTooShort { expected_bytes: self.exclusive_end_byte(), received_bytes: frame.len() })
    }

    fn is_met((field, expected): &FieldCondition, frame: &[u8]) -> bool {
        let number = field.extract(frame);
        number.is_some_and(|number| expected.map_or(number != 0, |expected| number == expected))
    }
}

impl FrameLayout {
    /// Checks the layout of frames of `frame_bytes` bytes; `order` applies to numbers without an order of their
    /// own.
    ///
    /// # Errors
    /// The layout is invalid; the message names the keys.
    pub fn new(
        value: FrameValueKeys,
        counter_keys: Option<FrameCounterKeys>,
        encoder_keys: Option<FrameEncoderKeys>,
        status: Vec<FrameStatusKeys>,
        order: Option<Endianness>,
        frame_bytes: usize,
    ) -> Result<Self, String> {
        let FrameValueKeys { byte, bit, width, signed, scale_mm, offset_mm, codes, .. } = value;
        let value = BitField::new("value", byte, bit, width, signed, value.order.or(order))?;
        check_scale(scale_mm, offset_mm)?;
        let code = |code: &FrameCodeKeys| {
            Ok(((value, Some(check_representable("value", code.is, value)?)), code.means.reading_flag()))
        };
        let codes = codes.iter().map(code).collect::<Result<Vec<_>, String>>()?;
        let counter = counter_keys.map(|keys| counter_field_and_modulus(&keys, order)).transpose()?;
        let encoder = encoder_keys.map(|keys| encoder_field_and_modulus(&keys, order)).transpose()?;
        let mut flags = status_conditions_with_flags(&status, order)?;
        let fields = [("value".to_owned(), value)].into_iter();
        let fields = fields.chain(counter.map(|(field, _)| ("counter".to_owned(), field)));
        let fields = fields.chain(encoder.map(|(field, _)| ("encoder_count".to_owned(), field)));
        let is_first =
            |index: usize, field: BitField| !flags.iter().take(index).any(|((earlier, _), _)| *earlier == field);
        let status = status_entry_names().zip(flags.iter().map(|((field, _), _)| *field)).enumerate();
        let status = status.filter(|(index, (_, field))| is_first(*index, *field));
        let min_bytes = check_fields_and_count_bytes(fields.chain(status.map(|(_, named)| named)), frame_bytes)?;
        flags.extend(codes);
        let sample = SampleLayout {
            value_location: value,
            scale_mm,
            offset_mm,
            counter_and_modulus: counter,
            encoder_and_modulus: encoder,
            conditions_with_flags: flags,
        };
        Ok(Self { sample_layout: sample, required_bytes: min_bytes })
    }

    /// # Errors
    /// The frame is too short for the layout.
    pub fn decode(&self, frame: &[u8]) -> Result<DecodedSample, FrameTooShort> {
        if frame.len() < self.required_bytes {
            return Err(FrameTooShort { expected_bytes: self.required_bytes, received_bytes: frame.len() });
        }
        self.sample_layout.decode(frame)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the frame has {received_bytes} bytes, but the layout needs {expected_bytes}")]
pub struct FrameTooShort {
    /// Minimum number of bytes that the layout needs.
    pub expected_bytes: usize,
    pub received_bytes: usize,
}

fn counter_field_and_modulus(keys: &FrameCounterKeys, order: Option<Endianness>) -> Result<(BitField, u64), String> {
    let FrameCounterKeys { byte, bit, width, .. } = *keys;
    let field = BitField::new("counter", byte, bit, width, false, keys.order.or(order))?;
    if width > MAX_COUNTER_BITS {
        return Err(format!("`counter.width` is {width}; the maximum is {MAX_COUNTER_BITS}"));
    }
    Ok((field, 1 << width))
}

fn encoder_field_and_modulus(keys: &FrameEncoderKeys, order: Option<Endianness>) -> Result<(BitField, u64), String> {
    let FrameEncoderKeys { byte, bit, width, .. } = *keys;
    let field = BitField::new("encoder_count", byte, bit, width, false, keys.order.or(order))?;
    Ok((field, encoder_count::resolve_modulus("encoder_count", keys.round, width)?))
}

/// Returns the condition of each status entry, with the flag of a sample that meets it.
fn status_conditions_with_flags(
    status: &[FrameStatusKeys],
    order: Option<Endianness>,
) -> Result<Vec<(FieldCondition, ReadingFlag)>, String> {
    let mut conditions: Vec<(FieldCondition, ReadingFlag)> = Vec::new();
    for (name, keys) in status_entry_names().zip(status) {
        let FrameStatusKeys { byte, bit, width, .. } = *keys;
        let field = BitField::new(&name, byte, bit, width, false, keys.order.or(order))?;
        let is = keys.is.map(|is| check_representable(&name, is, field)).transpose()?;
        // Several entries may use the same bits, each with its own number.
        let same = conditions.iter().position(|((earlier, expected), _)| {
            *earlier == field && expected.is_none_or(|expected| Some(expected) == is)
        });
        if let Some(earlier) = same {
            return Err(format!(
                "`status {}` and `{name}` are met at the same time: they have the same bits; set a different `is` \
                 for each, and put the status without `is` last",
                earlier + 1
            ));
        }
        conditions.push(((field, is), keys.means.reading_flag()));
    }
    Ok(conditions)
}

/// Returns `number`; error if `field` cannot hold it.
fn check_representable(name: &str, number: i64, field: BitField) -> Result<i128, String> {
    let (least, greatest) = field.number_range();
    if (least..=greatest).contains(&i128::from(number)) {
        return Ok(i128::from(number));
    }
    let width = field.bit_width;
    Err(format!("`{name}` can never be {number}: {width} bits hold {least} to {greatest}"))
}

/// Names of the status entries in messages: `status 1`, `status 2` and so on.
fn status_entry_names() -> impl Iterator<Item = String> {
    (1..).map(|number: u32| format!("status {number}"))
}

/// Checks that no bit belongs to two fields and that no field extends beyond `frame_bytes` bytes. Returns the number of
/// bytes that the fields need.
fn check_fields_and_count_bytes(
    fields: impl Iterator<Item = (String, BitField)>,
    frame_bytes: usize,
) -> Result<usize, String> {
    let mut taken = BTreeMap::new();
    let mut expected_bytes = 0;
    for (name, field) in fields {
        let end = field.exclusive_end_byte();
        if end > frame_bytes {
            return Err(format!(
                "`{name}` extends to byte {}; the frame has the {frame_bytes} bytes 0 to {}",
                end - 1,
                frame_bytes.saturating_sub(1)
            ));
        }
        expected_bytes = expected_bytes.max(end);
        for (byte, bit) in field.bit_positions() {
            if let Some(other) = taken.insert((byte, bit), name.clone()) {
                return Err(format!(
                    "`{other}` and `{name}` overlap at byte {byte}, bit {bit}: compare both with the \
                     sensor's manual"
                ));
            }
        }
    }
    Ok(expected_bytes)
}
