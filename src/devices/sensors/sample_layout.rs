//! Layout of one sample, common to CAN, serial and Modbus sensors: value, counter, encoder count and the
//! conditions that mark the value as invalid. Each transport defines the locations in its data.

use serde::Deserialize;

use super::encoder_count;
use machine::record::reading::ReadingFlag;

/// Location of a number in the data of one transport.
pub trait NumberLocation: Copy {
    /// Data of one sample: the bytes of a frame, the columns of a line, the registers of one request.
    type Data<'d>: Copy;
    type Error;
    /// Condition on the data under which the value is invalid.
    type Condition;

    /// Reads the number as it was sent, before scale and offset.
    fn read_number(self, data: Self::Data<'_>) -> Result<f64, Self::Error>;
    /// Reads the number of a counter or of an encoder as it was sent.
    fn read_integer(self, data: Self::Data<'_>) -> Result<i128, Self::Error>;
    /// Whether the condition is met, so that the value is invalid.
    fn is_met(condition: &Self::Condition, data: Self::Data<'_>) -> bool;
}

/// Layout of a sample that has passed the checks.
#[derive(Debug, Clone)]
pub struct SampleLayout<L: NumberLocation> {
    /// Location of the number; value = `offset_mm` + `scale_mm` × the number.
    pub value_location: L,
    /// Size of one count, mm; negative if the sensor counts in the other direction.
    pub scale_mm: f64,
    pub offset_mm: f64,
    /// Location of the counter, and number of samples after which the counter restarts.
    pub counter_and_modulus: Option<(L, u64)>,
    /// Location of the encoder count, and number of counts after which the count restarts.
    pub encoder_and_modulus: Option<(L, u64)>,
    /// Conditions under which the value is invalid, each with its flag; the first condition that is met applies.
    pub conditions_with_flags: Vec<(L::Condition, ReadingFlag)>,
}

/// Sample decoded from the data of a sensor, without its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DecodedSample {
    /// Value in mm, or the reason why there is none.
    pub value_mm: Result<f64, ReadingFlag>,
    /// Count of the sample counter; `None` if the sensor has no counter.
    pub counter_value: Option<u64>,
    /// Count of the rotary encoder, wrapped at its modulus (`encoder_count.rs`).
    pub wrapped_encoder_count: Option<u32>,
}

/// Reason why a value is invalid: the meaning of a code or of a status.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InvalidReason {
    /// No echo comes back from a surface.
    NoEcho,
    /// The distance is out of the sensor's range.
    Range,
    /// Too much light comes back.
    Saturated,
    /// The value was already reported earlier.
    Stale,
}

impl InvalidReason {
    /// Flag of the sample; `NoEcho` and `Range` both give `Range`.
    pub fn reading_flag(self) -> ReadingFlag {
        match self {
            Self::NoEcho | Self::Range => ReadingFlag::Range,
            Self::Saturated => ReadingFlag::Saturated,
            Self::Stale => ReadingFlag::Stale,
        }
    }
}

impl<L: NumberLocation> SampleLayout<L> {
    /// Number of samples after which the counter restarts, if there is one.
    pub fn counter_modulus(&self) -> Option<u64> {
        self.counter_and_modulus.map(|(_, modulus)| modulus)
    }

    /// Number of counts after which the encoder's count restarts, if a sample has one.
    pub fn encoder_modulus(&self) -> Option<u64> {
        self.encoder_and_modulus.map(|(_, modulus)| modulus)
    }

    /// Decodes one sample; an invalid value is no error but the flag of the first condition that is met.
    ///
    /// # Errors
    /// The data do not match the layout.
    pub fn decode(&self, data: L::Data<'_>) -> Result<DecodedSample, L::Error> {
        let counter = self.counter_and_modulus.map(|(counter, _)| counter.read_integer(data)).transpose()?;
        let wrapped_encoder_count = match self.encoder_and_modulus {
            Some((count, modulus)) => Some(encoder_count::wrap_count(count.read_integer(data)?, modulus)),
            None => None,
        };
        let value = match self.conditions_with_flags.iter().find(|(condition, _)| L::is_met(condition, data)) {
            Some((_, flag)) => Err(*flag),
            None => Ok(self.offset_mm + self.scale_mm * self.value_location.read_number(data)?),
        };
        // A negative counter in a line of text becomes a very large number, which `LineFormat::decode` refuses.
        Ok(DecodedSample { value_mm: value, counter_value: counter.map(|count| count as u64), wrapped_encoder_count })
    }
}

/// # Errors
/// A factor of 0, or a number that is not finite; the message names the key.
pub fn check_scale(scale_mm: f64, offset_mm: f64) -> Result<(), String> {
    if scale_mm == 0.0 || !scale_mm.is_finite() {
        return Err(format!(
            "`value.scale_mm` is {scale_mm}: all readings would be equal; set it to the size of one count \
             in mm, e.g. 0.001, or to 1.0 for values in mm"
        ));
    }
    if !offset_mm.is_finite() {
        return Err("`value.offset_mm` must be a finite number".to_owned());
    }
    Ok(())
}

impl DecodedSample {
    /// Replaces a value beyond the sensor's range, whose ends are inclusive, by the flag `Range`.
    pub fn flag_out_of_range(self, [least, greatest]: [f64; 2]) -> Self {
        let value = self
            .value_mm
            .and_then(|mm| if (least..=greatest).contains(&mm) { Ok(mm) } else { Err(ReadingFlag::Range) });
        Self { value_mm: value, ..self }
    }
}
