//! Error parameters by their ISO 230-1 names: each scales a one-parameter motion φ(q)·e_k.

use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

use crate::Axis;

/// Dependence of an error on the command `q` of its axis (rad or mm, sign as commanded).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorShape {
    /// φ = 1: location error, e.g. `EX0C`.
    Location,
    /// φ = q: linear gain of a linear axis, e.g. `EXX1`.
    Gain,
    /// φ = sin nq: error motion of a rotary axis, e.g. `EXC_sin2`.
    Sin(u32),
    /// φ = cos nq, e.g. `EXC_cos2`.
    Cos(u32),
    /// One entry of a periodic table with `count` equispaced angles from 0, linear in between, e.g.
    /// `EXC_3/36`: φ is 1 at its own angle and 0 at the others.
    LookupTableEntry { index: u32, count: u32 },
}

/// One error parameter: component X, Y, Z (mm) or A, B, C (rad) of the error of `axis`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ErrorParameter {
    component: Axis,
    axis: Axis,
    shape: ErrorShape,
}

/// A parameter and its value in mm, rad, mm/mm (gains).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorTerm {
    pub parameter: ErrorParameter,
    pub value: f64,
}

impl ErrorParameter {
    /// # Errors
    /// Component S; a gain of a rotary axis or with an angular component (the pose would no longer be affine in X,
    /// Y, Z); an error motion of a linear axis; harmonic 0; an entry outside its table.
    pub fn new(component: Axis, axis: Axis, shape: ErrorShape) -> Result<Self, InvalidErrorParameter> {
        let parameter = Self { component, axis, shape };
        let is_valid = match shape {
            ErrorShape::Location => true,
            ErrorShape::Gain => axis.is_linear() && component.is_linear(),
            ErrorShape::Sin(n) | ErrorShape::Cos(n) => !axis.is_linear() && n > 0,
            ErrorShape::LookupTableEntry { index, count } => !axis.is_linear() && count > 1 && index < count,
        };
        if is_valid && component != Axis::S { Ok(parameter) } else { Err(InvalidErrorParameter(parameter.to_string())) }
    }

    pub fn component(self) -> Axis {
        self.component
    }

    pub fn axis(self) -> Axis {
        self.axis
    }

    pub fn shape(self) -> ErrorShape {
        self.shape
    }

    /// φ(q) at the axis command `q`.
    pub fn shape_factor(self, q: f64) -> f64 {
        match self.shape {
            ErrorShape::Location => 1.0,
            ErrorShape::Gain => q,
            ErrorShape::Sin(n) => (f64::from(n) * q).sin(),
            ErrorShape::Cos(n) => (f64::from(n) * q).cos(),
            ErrorShape::LookupTableEntry { index, count } => {
                let turns = q / TAU - f64::from(index) / f64::from(count);
                let nearest = (turns - turns.round()).abs();
                (1.0 - nearest * f64::from(count)).max(0.0)
            }
        }
    }
}

/// `EX0C`, `EXX1`, `EXC_sin2`, `EXC_cos2`, `EXC_3/36`.
impl fmt::Display for ErrorParameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { component, axis, shape } = self;
        match shape {
            ErrorShape::Location => write!(f, "E{component}0{axis}"),
            ErrorShape::Gain => write!(f, "E{component}{axis}1"),
            ErrorShape::Sin(n) => write!(f, "E{component}{axis}_sin{n}"),
            ErrorShape::Cos(n) => write!(f, "E{component}{axis}_cos{n}"),
            ErrorShape::LookupTableEntry { index, count } => write!(f, "E{component}{axis}_{index}/{count}"),
        }
    }
}

/// Parses the names that `Display` writes, and the same names with an underscore after the `E`.
impl FromStr for ErrorParameter {
    type Err = InvalidErrorParameter;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse_error_parameter(text).ok_or_else(|| InvalidErrorParameter(text.to_owned()))?
    }
}

/// `None`: the text does not have the form of a name; error: `ErrorParameter::new` refuses the combination.
fn parse_error_parameter(text: &str) -> Option<Result<ErrorParameter, InvalidErrorParameter>> {
    let name = text.strip_prefix("E_").or_else(|| text.strip_prefix('E'))?;
    let (head, suffix) = name.split_once('_').map_or((name, None), |(head, suffix)| (head, Some(suffix)));
    let letters: Vec<char> = head.chars().collect();
    let axis = |letter: char| letter.to_string().parse::<Axis>().ok();
    let (component, axis, shape) = match (letters.as_slice(), suffix) {
        ([k, '0', a], None) => (axis(*k)?, axis(*a)?, ErrorShape::Location),
        ([k, a, '1'], None) => (axis(*k)?, axis(*a)?, ErrorShape::Gain),
        ([k, a], Some(suffix)) => (axis(*k)?, axis(*a)?, parse_error_motion(suffix)?),
        _ => return None,
    };
    Some(ErrorParameter::new(component, axis, shape))
}

/// Shape from the part of the name after `_`, such as `sin2`, `cos2` or `3/36`.
fn parse_error_motion(suffix: &str) -> Option<ErrorShape> {
    if let Some(n) = suffix.strip_prefix("sin") {
        return n.parse().ok().map(ErrorShape::Sin);
    }
    if let Some(n) = suffix.strip_prefix("cos") {
        return n.parse().ok().map(ErrorShape::Cos);
    }
    let (index, count) = suffix.split_once('/')?;
    Some(ErrorShape::LookupTableEntry { index: index.parse().ok()?, count: count.parse().ok()? })
}

/// Error: the name is not an error parameter.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is not an error parameter; write a location error as EX0C, the gain of a linear axis as EXX1, an error motion of a rotary axis as EXC_sin1 or EXC_cos1, an entry of a periodic table of 36 entries as EXC_0/36"
)]
pub struct InvalidErrorParameter(pub String);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_parameters_parse_with_or_without_underscore_and_print_without() {
        for name in ["EX0C", "EC0Y", "EY0S", "EXX1", "EYZ1", "EXC_sin2", "EAB_cos1", "EXC_3/36"] {
            let parameter: ErrorParameter = name.parse().unwrap();
            assert_eq!(parameter.to_string(), name);
            let underscored = name.replacen('E', "E_", 1);
            assert_eq!(underscored.parse::<ErrorParameter>().unwrap(), parameter);
        }
    }

    #[test]
    fn invalid_parameter_names_are_refused() {
        for name in ["X0C", "EXC", "ES0C", "EX0U", "EXC1", "ECX1", "EXX_sin1", "EXC_sin0", "EXC_9/9", ""] {
            assert_eq!(name.parse::<ErrorParameter>().unwrap_err().0, name);
        }
    }

    #[test]
    fn lookup_table_entry_shape_is_periodic_and_falls_linearly_to_zero() {
        let parameter: ErrorParameter = "EXC_0/8".parse().unwrap();
        let at = |degrees: f64| parameter.shape_factor(degrees.to_radians());
        for (degrees, expected) in [(0.0, 1.0), (22.5, 0.5), (-22.5, 0.5), (45.0, 0.0), (180.0, 0.0)] {
            assert!((at(degrees) - expected).abs() < 1e-12);
            assert!((at(degrees + 720.0) - expected).abs() < 1e-12);
        }
    }
}
