//! Axis names (ISO 841) and positions of several axes at once.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fmt;
use std::str::FromStr;

use nalgebra::Vector3;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A machine axis; `S` is the orientation of the spindle about its own axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Axis {
    X,
    Y,
    Z,
    A,
    B,
    C,
    S,
}

impl Axis {
    pub const LINEAR: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];
    pub const ALL: [Axis; 7] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C, Axis::S];

    pub fn is_linear(self) -> bool {
        matches!(self, Axis::X | Axis::Y | Axis::Z)
    }

    /// Nominal direction of travel, or of the axis of rotation, after ISO 841: A, B and C rotate about X, Y and Z. The
    /// spindle rotates about Z.
    pub fn nominal_direction(self) -> Vector3<f64> {
        match self {
            Axis::X | Axis::A => Vector3::x(),
            Axis::Y | Axis::B => Vector3::y(),
            Axis::Z | Axis::C | Axis::S => Vector3::z(),
        }
    }

    pub fn letter(self) -> char {
        ['X', 'Y', 'Z', 'A', 'B', 'C', 'S'][self as usize]
    }

    /// Letter of the axis as text.
    pub fn name(self) -> &'static str {
        ["X", "Y", "Z", "A", "B", "C", "S"][self as usize]
    }

    /// Converts a value of files and messages (mm or degrees) to the internal unit (mm or rad).
    pub fn to_mm_or_rad(self, external: f64) -> f64 {
        if self.is_linear() {
            return external;
        }
        let rad = external * PI / 180.0;
        // No machine reaches a value that overflows here, but a file may contain one.
        if rad.is_finite() { rad } else { external.to_radians() }
    }

    /// Converts an internal value (mm or rad) to the unit of files and messages (mm or degrees). Degrees are rounded to
    /// 1e-9, far below any machine's resolution, so that 120° prints as 120 and not as 119.99999999999999.
    pub fn to_mm_or_deg(self, value: f64) -> f64 {
        if self.is_linear() {
            return value;
        }
        let rounded = (value * 180.0 / PI * 1e9).round() / 1e9;
        if rounded.is_finite() { rounded } else { value.to_degrees() }
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.letter())
    }
}

impl FromStr for Axis {
    type Err = UnknownAxis;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Axis::ALL
            .into_iter()
            .find(|axis| text.len() == 1 && text.starts_with(axis.letter()))
            .ok_or_else(|| UnknownAxis(text.to_owned()))
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown axis `{0}`; the axes are X, Y, Z, A, B, C and S")]
pub struct UnknownAxis(pub String);

/// Positions of some axes: mm for X, Y, Z; rad for A, B, C, S. Serialized as `{"X":..,"C":..}` in mm and degrees.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Position(BTreeMap<Axis, f64>);

impl Position {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn with(mut self, axis: Axis, value: f64) -> Self {
        self.0.insert(axis, value);
        self
    }

    pub fn set(&mut self, axis: Axis, value: f64) {
        self.0.insert(axis, value);
    }

    pub fn get(&self, axis: Axis) -> Option<f64> {
        self.0.get(&axis).copied()
    }

    /// Position of the axis; 0 if the axis is not contained.
    pub fn get_or_zero(&self, axis: Axis) -> f64 {
        self.get(axis).unwrap_or(0.0)
    }

    /// Position of X, Y and Z alone, mm.
    pub fn from_xyz(xyz: Vector3<f64>) -> Self {
        Axis::LINEAR.into_iter().zip(xyz.iter().copied()).collect()
    }

    /// X, Y and Z, mm; 0 for an axis that is not contained.
    pub fn xyz_or_zero(&self) -> Vector3<f64> {
        Axis::LINEAR.map(|axis| self.get_or_zero(axis)).into()
    }

    pub fn iter(&self) -> impl Iterator<Item = (Axis, f64)> + '_ {
        self.0.iter().map(|(axis, value)| (*axis, *value))
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// This position, with every axis that `other` contains taken from `other`.
    pub fn updated_by(&self, other: &Position) -> Position {
        let mut merged = self.clone();
        merged.0.extend(other.iter());
        merged
    }

    /// The position after writing to a file and reading back: rotary positions in whole steps of 1e-9 degrees.
    pub fn rounded_to_file_resolution(&self) -> Position {
        self.iter().map(|(axis, value)| (axis, axis.to_mm_or_rad(axis.to_mm_or_deg(value)))).collect()
    }

    /// The axes for which `keep` returns true.
    pub fn filter_axes(&self, keep: impl Fn(Axis) -> bool) -> Position {
        Position(self.iter().filter(|(axis, _)| keep(*axis)).collect())
    }
}

impl FromIterator<(Axis, f64)> for Position {
    fn from_iter<I: IntoIterator<Item = (Axis, f64)>>(iter: I) -> Self {
        Position(iter.into_iter().collect())
    }
}

impl Serialize for Position {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter().map(|(axis, value)| (axis, axis.to_mm_or_deg(value))))
    }
}

impl<'de> Deserialize<'de> for Position {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let external = BTreeMap::<Axis, f64>::deserialize(deserializer)?;
        Ok(external.into_iter().map(|(axis, value)| (axis, axis.to_mm_or_rad(value))).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_is_serialized_in_degrees() {
        let position = Position::new().with(Axis::X, 1.5).with(Axis::C, 2.0 * PI / 3.0);
        let json = serde_json::to_string(&position).unwrap();
        assert_eq!(json, r#"{"X":1.5,"C":120.0}"#);
        let back: Position = serde_json::from_str(&json).unwrap();
        assert!((back.get_or_zero(Axis::C) - 2.0 * PI / 3.0).abs() < 1e-12);
    }
}
