//! Map of the registers: the content of each register.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::sensors::encoder;
use crate::sensors::layout::{Decoded, Means};
use link::modbus::value::{Kind, Number, Order, ValueError};
use link::modbus::{Range, Space};
use machine::record::reading::Flag;

/// Keys of the value: value = `offset_mm` + `scale_mm` × the number; registers count from 0.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ValueKeys {
    register: u16,
    #[serde(rename = "type")]
    kind: Kind,
    #[serde(default)]
    order: Order,
    scale_mm: f64,
    #[serde(default)]
    offset_mm: f64,
    #[serde(default)]
    codes: Vec<CodeKeys>,
    /// Meaning of a number that is not finite (`f32`, `f64`).
    nan: Option<Means>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CodeKeys {
    is: f64,
    means: Means,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CounterKeys {
    register: u16,
    #[serde(rename = "type")]
    kind: Kind,
    #[serde(default)]
    order: Order,
    #[serde(default)]
    gaps: bool,
}

/// Keys of the count of a rotary encoder: an integer of one register or two.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EncoderCountKeys {
    register: u16,
    #[serde(rename = "type")]
    kind: Kind,
    #[serde(default)]
    order: Order,
    /// Number of counts after which the count restarts; if absent, the capacity of its registers.
    round: Option<u64>,
}

/// Keys of a status: bits of a register with a meaning that applies if they hold `is` (absent: any number
/// but zero).
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StatusKeys {
    register: u16,
    #[serde(default)]
    bit: u16,
    #[serde(default = "one")]
    width: u16,
    is: Option<u16>,
    means: Means,
}

fn one() -> u16 {
    1
}

/// A register map that has passed the checks.
#[derive(Debug, Clone)]
pub(super) struct Map {
    /// All registers that are read, in one request.
    pub span: Range,
    value: (u16, Number),
    scale_mm: f64,
    offset_mm: f64,
    codes: Vec<(f64, Flag)>,
    nan: Option<Flag>,
    counter: Option<(u16, Number)>,
    /// Number of the encoder's count, and number of different counts.
    encoder: Option<((u16, Number), u64)>,
    pub gaps: bool,
    status: Vec<Status>,
}

#[derive(Debug, Clone, Copy)]
struct Status {
    register: u16,
    bit: u16,
    mask: u16,
    is: Option<u16>,
    flag: Flag,
}

/// Maximum number of registers in one request.
const MOST_READ: u16 = 125;

impl Map {
    /// # Errors
    /// The map is invalid; the message names the keys.
    pub fn new(
        space: Space,
        value: ValueKeys,
        counter: Option<CounterKeys>,
        encoder: Option<EncoderCountKeys>,
        status: Vec<StatusKeys>,
    ) -> Result<Self, String> {
        check_value(&value)?;
        if counter.as_ref().is_some_and(|counter| !matches!(counter.kind, Kind::U16 | Kind::U32)) {
            return Err("`counter.type` must be a whole number: `u16` or `u32`".to_owned());
        }
        let place = (value.register, number(value.kind, value.order));
        let gaps = counter.as_ref().is_some_and(|counter| counter.gaps);
        let counter =
            counter.map(|counter| (counter.register, number(counter.kind, counter.order)));
        let encoder = encoder.map(|keys| encoder_registers(&keys)).transpose()?;
        let status = status.into_iter().map(Status::try_from).collect::<Result<Vec<_>, _>>()?;
        told_apart(&status)?;
        Ok(Self {
            span: span(
                space,
                place,
                [("counter", counter), ("encoder_count", encoder.map(|e| e.0))],
                &status,
            )?,
            value: place,
            scale_mm: value.scale_mm,
            offset_mm: value.offset_mm,
            codes: value.codes.iter().map(|code| (code.is, code.means.flag())).collect(),
            nan: value.nan.map(Means::flag),
            counter,
            encoder,
            gaps,
            status,
        })
    }

    /// Size of one count, mm; 0 for floating-point numbers.
    pub fn count_mm(&self) -> f64 {
        if self.value.1.kind.is_float() { 0.0 } else { self.scale_mm.abs() }
    }

    /// Number of samples after which the counter restarts, if there is one.
    pub fn round(&self) -> Option<u64> {
        let bits = 16 * u32::from(self.counter?.1.registers());
        Some(1_u64.checked_shl(bits).unwrap_or(u64::MAX))
    }

    /// Number of counts after which the encoder's count restarts, if there is one.
    pub fn encoder_round(&self) -> Option<u64> {
        self.encoder.map(|(_, round)| round)
    }

    /// Decodes the registers of the span.
    ///
    /// # Errors
    /// The registers hold no number.
    pub fn read(&self, words: &[u16]) -> Result<Decoded, ValueError> {
        let number = |(register, number): (u16, Number)| {
            let at = usize::from(register.saturating_sub(self.span.first));
            let end = at + usize::from(number.registers());
            number.read(words.get(at..end).unwrap_or_default())
        };
        // The conversion is exact: the number is an integer and not negative, because signed types are
        // refused.
        let counter = self.counter.map(number).transpose()?.map(|count| count as u64);
        // The conversion is exact: the count has 32 bits at most.
        let wrapped = |(at, round)| number(at).map(|count| encoder::wrapped(count as i128, round));
        let encoder_count = self.encoder.map(wrapped).transpose()?;
        let holds = |status: &&Status| {
            let at = usize::from(status.register.saturating_sub(self.span.first));
            let found = words.get(at).map_or(0, |word| word >> status.bit & status.mask);
            status.is.map_or(found != 0, |is| found == is)
        };
        let says = self.status.iter().find(holds).map(|status| status.flag);
        let value = match (says, number(self.value), self.nan) {
            (Some(flag), ..) | (None, Err(ValueError::NotFinite(_)), Some(flag)) => Err(flag),
            (None, raw, _) => {
                let raw = raw?;
                let code = self.codes.iter().find(|(is, _)| *is == raw);
                code.map_or(Ok(self.offset_mm + self.scale_mm * raw), |(_, flag)| Err(*flag))
            }
        };
        Ok(Decoded { value, counter, encoder_count })
    }
}

fn number(kind: Kind, order: Order) -> Number {
    Number { kind, order, scale: 1.0 }
}

fn encoder_registers(keys: &EncoderCountKeys) -> Result<((u16, Number), u64), String> {
    let bits = match keys.kind {
        Kind::U16 | Kind::I16 => 16,
        Kind::U32 | Kind::I32 => 32,
        _ => {
            return Err("`encoder_count.type` must be `u16`, `i16`, `u32` or `i32`".to_owned());
        }
    };
    let round = encoder::round(keys.round, bits)?;
    Ok(((keys.register, number(keys.kind, keys.order)), round))
}

impl TryFrom<StatusKeys> for Status {
    type Error = String;

    fn try_from(
        StatusKeys { register, bit, width, is, means }: StatusKeys,
    ) -> Result<Self, String> {
        if width == 0 || bit.saturating_add(width) > 16 {
            return Err(format!("`status` at register {register}: a register has bits 0 to 15"));
        }
        let mask = u16::MAX >> (16 - width);
        if let Some(is) = is.filter(|is| *is > mask) {
            return Err(format!(
                "`status` at register {register} can never be {is}: {width} bits hold 0 to {mask}"
            ));
        }
        Ok(Self { register, bit, mask, is, flag: means.flag() })
    }
}

/// Checks that several status entries in the same bits have different numbers, and that no entries overlap
/// in part.
fn told_apart(status: &[Status]) -> Result<(), String> {
    for (at, one) in status.iter().enumerate() {
        let bits = |of: &Status| of.mask << of.bit;
        let before = status.iter().take(at).filter(|other| other.register == one.register);
        for other in before.filter(|other| bits(other) & bits(one) != 0) {
            let (first, second) = (other.bit, one.bit);
            if bits(other) != bits(one) {
                return Err(format!(
                    "`status` at register {}: the bits from {first} and those from {second} overlap: \
                     compare both with the sensor's manual",
                    one.register
                ));
            }
            if other.is.is_none_or(|is| Some(is) == one.is) {
                return Err(format!(
                    "`status` at register {}, bit {first}: two words hold at once; give each an `is` of its \
                     own, the one without behind the others",
                    one.register
                ));
            }
        }
    }
    Ok(())
}

fn check_value(value: &ValueKeys) -> Result<(), String> {
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
    if value.nan.is_some() && !value.kind.is_float() {
        return Err(
            "`value.nan` belongs to `f32` and `f64`; write `codes` for a whole number".to_owned()
        );
    }
    Ok(())
}

/// Returns the span of all registers. None is used twice, but several status entries may use one register.
fn span(
    space: Space,
    value: (u16, Number),
    counts: [(&'static str, Option<(u16, Number)>); 2],
    status: &[Status],
) -> Result<Range, String> {
    let mut taken = BTreeMap::new();
    let numbers = [("value", Some(value))].into_iter().chain(counts);
    let numbers =
        numbers.filter_map(|(name, at)| at.map(|(at, number)| (name, at, number.registers())));
    let words = status.iter().map(|status| ("status", status.register, 1));
    for (name, register, count) in numbers.chain(words) {
        let Some(last) = register.checked_add(count - 1) else {
            return Err(format!("`{name}` at {register} reaches beyond register 65535"));
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
    if last - first >= MOST_READ {
        return Err(format!(
            "registers {first} to {last} are too many for one request, which takes {MOST_READ}: value, \
             status and counter must be of the same moment"
        ));
    }
    Ok(Range { space, first, last })
}
