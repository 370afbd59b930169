//! Map of a sensor's registers: which registers hold the value, the counter, the encoder count and the status.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::sensors::encoder_count;
use crate::sensors::sample_layout::{InvalidReason, NumberLocation, SampleLayout, check_scale};
use link::modbus::number_format::{ByteOrder, NumberFormat, NumberType, RegisterValueError};
use link::modbus::{RegisterRange, RegisterSpace};
use machine::record::reading::ReadingFlag;

/// Keys of the value: value = `offset_mm` + `scale_mm` × the number; registers count from 0.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RegisterValueKeys {
    register: u16,
    #[serde(rename = "type")]
    number_type: NumberType,
    #[serde(default)]
    order: ByteOrder,
    /// Size of one count, mm; negative if the sensor counts in the other direction.
    scale_mm: f64,
    #[serde(default)]
    offset_mm: f64,
    /// Numbers that are codes, not values.
    #[serde(default)]
    codes: Vec<RegisterCodeKeys>,
    /// Meaning of a number that is not finite (`f32`, `f64`).
    nan: Option<InvalidReason>,
}

/// Keys of a code: while the value has the number `is`, it is invalid for the reason `means`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RegisterCodeKeys {
    /// Number in the registers, before scale and offset.
    is: f64,
    means: InvalidReason,
}

/// Keys of the counter, which increases by one with each sample and wraps around at the width of its type.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RegisterCounterKeys {
    register: u16,
    #[serde(rename = "type")]
    number_type: NumberType,
    #[serde(default)]
    order: ByteOrder,
    /// Whether samples that were missed between two reads are counted and flagged; otherwise they are ignored.
    #[serde(default)]
    gaps: bool,
}

/// Keys of the count of a rotary encoder: an integer of one register or two.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RegisterEncoderKeys {
    register: u16,
    #[serde(rename = "type")]
    number_type: NumberType,
    #[serde(default)]
    order: ByteOrder,
    /// Number of counts after which the count restarts; if absent, the capacity of its registers.
    round: Option<u64>,
}

/// Keys of a status: bits of a register that mark the value as invalid while they hold the number `is`, or any number
/// but zero if `is` is absent.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RegisterStatusKeys {
    register: u16,
    /// Lowest bit, from 0.
    #[serde(default)]
    bit: u16,
    /// Number of bits.
    #[serde(default = "default_width")]
    width: u16,
    is: Option<u16>,
    means: InvalidReason,
}

fn default_width() -> u16 {
    1
}

/// A register map that has passed the checks.
#[derive(Debug, Clone)]
pub(super) struct SensorRegisterMap {
    /// All registers that are read, in one request.
    pub span: RegisterRange,
    pub sample_layout: SampleLayout<RegisterLocation>,
    /// Whether samples that were missed between two reads are counted and flagged.
    pub counts_missing_samples: bool,
}

/// A number in registers.
#[derive(Debug, Clone, Copy)]
pub(super) struct RegisterLocation {
    /// Index of the number's first register in the span that is read.
    span_offset: usize,
    number_format: NumberFormat,
}

/// Condition under which the value is invalid.
#[derive(Debug, Clone)]
pub(super) enum RegisterCondition {
    Status(StatusBits),
    /// The number is not finite.
    NotFinite(RegisterLocation),
    /// The number, before scale and offset, is exactly this code.
    Code(RegisterLocation, f64),
}

/// Bits of one register that mark the value as invalid.
#[derive(Debug, Clone, Copy)]
pub(super) struct StatusBits {
    /// Index of the register in the span that is read; its address until the span is known.
    register: u16,
    lowest_bit: u16,
    /// Mask of the bits after the register is shifted right by `lowest_bit`.
    mask_after_shift: u16,
    /// Number of the bits for which the value is invalid; `None`: any number but zero.
    expected_bits: Option<u16>,
}

impl NumberLocation for RegisterLocation {
    /// Registers of the span.
    type Data<'d> = &'d [u16];
    type Error = RegisterValueError;
    type Condition = RegisterCondition;

    fn read_number(self, words: &[u16]) -> Result<f64, RegisterValueError> {
        let end = self.span_offset + usize::from(self.number_format.register_count());
        self.number_format.decode(words.get(self.span_offset..end).unwrap_or_default())
    }

    /// The conversion is exact: the types of counter and encoder are integers of 32 bits at most.
    fn read_integer(self, words: &[u16]) -> Result<i128, RegisterValueError> {
        self.read_number(words).map(|number| number as i128)
    }

    fn is_met(condition: &RegisterCondition, words: &[u16]) -> bool {
        match condition {
            RegisterCondition::Status(status) => {
                let word = words.get(usize::from(status.register)).copied().unwrap_or_default();
                let bits = word >> status.lowest_bit & status.mask_after_shift;
                status.expected_bits.map_or(bits != 0, |is| bits == is)
            }
            RegisterCondition::NotFinite(value) => {
                matches!(value.read_number(words), Err(RegisterValueError::NotFinite(_)))
            }
            RegisterCondition::Code(value, code) => value.read_number(words).is_ok_and(|v| v == *code),
        }
    }
}

/// Maximum number of registers in one request.
const MAX_READ_REGISTERS: u16 = 125;

impl SensorRegisterMap {
    /// # Errors
    /// The map is invalid; the message names the keys.
    pub fn new(
        space: RegisterSpace,
        value: RegisterValueKeys,
        counter_keys: Option<RegisterCounterKeys>,
        encoder_keys: Option<RegisterEncoderKeys>,
        status: Vec<RegisterStatusKeys>,
    ) -> Result<Self, String> {
        let RegisterValueKeys { scale_mm, offset_mm, .. } = value;
        check_scale(scale_mm, offset_mm)?;
        if value.nan.is_some() && !value.number_type.is_float() {
            return Err("`value.nan` is only for `f32` and `f64`; use `codes` for an integer".to_owned());
        }
        if counter_keys.as_ref().is_some_and(|keys| !matches!(keys.number_type, NumberType::U16 | NumberType::U32)) {
            return Err("`counter.type` must be an unsigned integer: `u16` or `u32`".to_owned());
        }
        let encoder_modulus = encoder_keys.as_ref().map(encoder_modulus).transpose()?;
        let mut status =
            status.into_iter().map(RegisterStatusKeys::checked_bits_and_flag).collect::<Result<Vec<_>, _>>()?;
        check_status_conflicts(&status)?;
        let numbers = [
            ("value", Some((value.register, value.number_type))),
            ("counter", counter_keys.as_ref().map(|keys| (keys.register, keys.number_type))),
            ("encoder_count", encoder_keys.as_ref().map(|keys| (keys.register, keys.number_type))),
        ];
        let span = register_span(space, numbers, &status)?;
        status.iter_mut().for_each(|(status, _)| status.register -= span.first);
        let status = status.into_iter().map(|(status, flag)| (RegisterCondition::Status(status), flag));
        let location = |register: u16, number_type, order| {
            let number_format = NumberFormat { number_type, order, scale: 1.0 };
            RegisterLocation { span_offset: usize::from(register - span.first), number_format }
        };
        let number = location(value.register, value.number_type, value.order);
        let nan = value.nan.map(|means| (RegisterCondition::NotFinite(number), means.reading_flag()));
        let codes = value.codes.iter();
        let codes = codes.map(|code| (RegisterCondition::Code(number, code.is), code.means.reading_flag()));
        let counts_gaps = counter_keys.as_ref().is_some_and(|keys| keys.gaps);
        let counter = counter_keys.map(|RegisterCounterKeys { register, number_type: kind, order, .. }| {
            (location(register, kind, order), 1 << (16 * kind.register_count()))
        });
        let encoder = encoder_keys
            .zip(encoder_modulus)
            .map(|(keys, modulus)| (location(keys.register, keys.number_type, keys.order), modulus));
        let flags = status.chain(nan).chain(codes).collect();
        let sample = SampleLayout {
            value_location: number,
            scale_mm,
            offset_mm,
            counter_and_modulus: counter,
            encoder_and_modulus: encoder,
            conditions_with_flags: flags,
        };
        Ok(Self { span, sample_layout: sample, counts_missing_samples: counts_gaps })
    }

    /// Size of one count, mm; 0 for floating-point numbers.
    pub fn count_size_mm(&self) -> f64 {
        let SampleLayout { value_location: value, scale_mm, .. } = &self.sample_layout;
        if value.number_format.number_type.is_float() { 0.0 } else { scale_mm.abs() }
    }
}

fn encoder_modulus(keys: &RegisterEncoderKeys) -> Result<u64, String> {
    match keys.number_type {
        NumberType::U16 | NumberType::I16 | NumberType::U32 | NumberType::I32 => {
            encoder_count::resolve_modulus("encoder_count", keys.round, 16 * keys.number_type.register_count())
        }
        _ => Err("`encoder_count.type` must be `u16`, `i16`, `u32` or `i32`".to_owned()),
    }
}

impl RegisterStatusKeys {
    fn checked_bits_and_flag(self) -> Result<(StatusBits, ReadingFlag), String> {
        let Self { register, bit, width, is, means } = self;
        if width == 0 || bit.saturating_add(width) > 16 {
            return Err(format!("`status` at register {register}: a register has bits 0 to 15"));
        }
        let mask = u16::MAX >> (16 - width);
        if let Some(is) = is.filter(|is| *is > mask) {
            return Err(format!("`status` at register {register} can never be {is}: {width} bits hold 0 to {mask}"));
        }
        Ok((StatusBits { register, lowest_bit: bit, mask_after_shift: mask, expected_bits: is }, means.reading_flag()))
    }
}

/// Checks that status entries with the same bits have different numbers, and that no two entries overlap in only some
/// of their bits.
fn check_status_conflicts(status: &[(StatusBits, ReadingFlag)]) -> Result<(), String> {
    for (index, (one, _)) in status.iter().enumerate() {
        let bits = |status: &StatusBits| status.mask_after_shift << status.lowest_bit;
        let before = status.iter().take(index).map(|(other, _)| other);
        let before = before.filter(|other| other.register == one.register);
        for other in before.filter(|other| bits(other) & bits(one) != 0) {
            let (first, second) = (other.lowest_bit, one.lowest_bit);
            if bits(other) != bits(one) {
                return Err(format!(
                    "`status` at register {}: the bits from {first} and those from {second} overlap: \
                     compare both with the sensor's manual",
                    one.register
                ));
            }
            if other.expected_bits.is_none_or(|is| Some(is) == one.expected_bits) {
                return Err(format!(
                    "`status` at register {}, bit {first}: two entries are met at the same time; set a different \
                     `is` for each, and put the entry without `is` last",
                    one.register
                ));
            }
        }
    }
    Ok(())
}

/// Returns the span of all registers. Error if a register is used twice, except by several status entries, or if the
/// span is too long for one request.
fn register_span(
    space: RegisterSpace,
    numbers: [(&'static str, Option<(u16, NumberType)>); 3],
    status: &[(StatusBits, ReadingFlag)],
) -> Result<RegisterRange, String> {
    let mut taken = BTreeMap::new();
    let numbers = numbers
        .into_iter()
        .filter_map(|(name, number)| number.map(|(register, kind)| (name, register, kind.register_count())));
    let words = status.iter().map(|(status, _)| ("status", status.register, 1));
    for (name, register, count) in numbers.chain(words) {
        let Some(last) = register.checked_add(count - 1) else {
            return Err(format!("`{name}` at register {register} extends beyond register 65535"));
        };
        for at in register..=last {
            let other = taken.insert(at, name);
            if let Some(other) = other.filter(|other| (*other, name) != ("status", "status")) {
                return Err(format!(
                    "`{other}` and `{name}` overlap at register {at}: compare both with the sensor's \
                     manual"
                ));
            }
        }
    }
    let first = taken.keys().next().copied().unwrap_or_default();
    let last = taken.keys().next_back().copied().unwrap_or_default();
    if last - first >= MAX_READ_REGISTERS {
        return Err(format!(
            "registers {first} to {last} are too many for one request (maximum {MAX_READ_REGISTERS}): value, \
             status and counter are read in one request"
        ));
    }
    Ok(RegisterRange { space, first, last })
}
