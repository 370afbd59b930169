//! Touches and samples at any rotary position as points of the workpiece: the machine tool as a coordinate
//! measuring machine (paper 2, Eq. (4); paper 4, section 6).

use faer::Mat;
use nalgebra::Vector3;

use super::standard_uncertainty;
use crate::MethodRefusal;
use crate::identification::declared_sources::coordinate_std_u_mm;
use crate::identification::{KnownErrors, prior_covariance};
use machine::frame::{Point, SpindleFrame};
use machine::kinematics::KinematicChain;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use machine::record::sensor::SensorMount;

/// A point in the table frame (the machine frame with all axes at zero), mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointInWorkpieceFrame {
    /// Centre of the stylus ball of a touch, or the measured point of a sensor sample.
    pub position_mm: Vector3<f64>,
    /// Standard uncertainty of each coordinate from the estimate with its stylus, and from what the plan declares of
    /// probe and axes for one point.
    pub u_mm: Vector3<f64>,
}

/// Position of the stylus ball centre relative to the spindle datum, spindle frame, mm.
struct StylusOffset {
    offset_mm: Vector3<f64>,
    /// Indices of the coordinates that the estimate contains: 0 for x to 2 for z. The others are stated in the
    /// machine file.
    estimated_coordinate_indices: Vec<usize>,
}

const STYLUS_SYMBOLS: [&str; 3] = ["tool_x", "tool_y", "tool_z"];

/// Computes points of the workpiece, in the table frame, from the readings of a plan.
pub struct WorkpieceTransform<'a> {
    plan: &'a Plan,
    chain: KinematicChain,
    /// Errors of the axes. `None`: the machine counts as free of errors.
    known_errors: Option<KnownErrors<'a>>,
    stylus: StylusOffset,
    /// Covariance of the errors, followed by the estimated stylus coordinates, internal units.
    covariance: Mat<f64>,
}

impl<'a> WorkpieceTransform<'a> {
    /// # Errors
    /// The machine has no kinematics; the estimate has no errors of its axes.
    pub fn new(plan: &'a Plan, estimate: Option<&'a Estimate>) -> Result<Self, MethodRefusal> {
        let chain = KinematicChain::new(&plan.machine)?;
        let known = estimate.map(|estimate| KnownErrors::from_estimate(estimate, &chain)).transpose()?;
        let stylus = StylusOffset::from_estimate(plan, estimate);
        let symbols = known.iter().flat_map(|known| known.symbols.iter().copied());
        let symbols: Vec<&str> =
            symbols.chain(stylus.estimated_coordinate_indices.iter().map(|k| STYLUS_SYMBOLS[*k])).collect();
        let covariance = match &known {
            // Only an estimate without a stylus states its location errors at another point than the model.
            Some(known) if stylus.estimated_coordinate_indices.is_empty() => Some(known.covariance.clone()),
            _ => estimate.and_then(|estimate| prior_covariance(estimate, &symbols)),
        };
        Ok(Self { plan, chain, known_errors: known, stylus, covariance: covariance.unwrap_or_else(Mat::new) })
    }

    /// Origin of the stylus coordinates, in words.
    pub fn describe_stylus(&self) -> String {
        match self.stylus.estimated_coordinate_indices.len() {
            0 => "stylus as stated in the machine file, with u = stylus_offset_um in each \
                  coordinate"
                .to_owned(),
            3 => "stylus of the estimate".to_owned(),
            _ => {
                let names: Vec<&str> =
                    self.stylus.estimated_coordinate_indices.iter().map(|k| STYLUS_SYMBOLS[*k]).collect();
                format!(
                    "{} of the estimate, the other stylus coordinates as stated in the machine \
                         file",
                    names.join(", ")
                )
            }
        }
    }

    /// The reading in the workpiece frame: the centre of the stylus ball of a touch. `None`: the sample has no
    /// distance, or its sensor is not in the spindle.
    pub fn point_in_workpiece_frame(&self, reading: &Reading) -> Option<PointInWorkpieceFrame> {
        let tip = self.point_in_spindle(reading)?;
        let (errors, parameters) = match &self.known_errors {
            Some(known) => (&known.errors[..], known.parameters()),
            None => (&[][..], Vec::new()),
        };
        let position = |point: Point<SpindleFrame>| self.chain.tip_in_table(&reading.position, point, errors).mm;
        let mut columns = self.chain.error_jacobian(&reading.position, tip, errors, &parameters);
        let is_touch = reading.value_mm.is_none();
        let by_stylus = |k: usize| position(Point::from_vec(tip.mm + Vector3::ith(k, 1.0))) - position(tip);
        let (estimated, stated): (Vec<usize>, Vec<usize>) =
            (0..3).partition(|k| self.stylus.estimated_coordinate_indices.contains(k));
        let no_effect = Vector3::zeros;
        columns.extend(estimated.into_iter().map(|k| if is_touch { by_stylus(k) } else { no_effect() }));
        let offset_mm = if is_touch { self.plan.probe.u_stylus_offset_um * 1e-3 } else { 0.0 };
        let own = coordinate_std_u_mm(self.plan, is_touch, reading.t_s).powi(2);
        let own =
            stated.into_iter().fold(Vector3::repeat(own), |sum, k| sum + (by_stylus(k) * offset_mm).map(|mm| mm * mm));
        let variance = standard_uncertainty(&columns, &self.covariance).map(|u| u * u) + own;
        Some(PointInWorkpieceFrame { position_mm: position(tip), u_mm: variance.map(f64::sqrt) })
    }

    /// Stylus ball centre of a touch, or the point that a spindle sensor measures, spindle frame. `None`: the sample
    /// has no distance, or its sensor is not in the spindle.
    fn point_in_spindle(&self, reading: &Reading) -> Option<Point<SpindleFrame>> {
        let sensor = self.plan.sensors.iter().find(|sensor| sensor.name == reading.sensor);
        let Some(sensor) = sensor else {
            return Some(Point::from_vec(self.stylus.offset_mm));
        };
        let along = Vector3::from(sensor.direction) * reading.value_mm?;
        (sensor.mount == SensorMount::Spindle).then(|| Point::from_vec(Vector3::from(sensor.zero_mm) + along))
    }
}

impl StylusOffset {
    /// The stylus of the estimate; coordinates that the estimate does not contain with their covariance come
    /// from the machine file.
    fn from_estimate(plan: &Plan, estimate: Option<&Estimate>) -> Self {
        let mut stylus =
            Self { offset_mm: Vector3::from(plan.machine.tool_mm), estimated_coordinate_indices: Vec::new() };
        let Some(estimate) = estimate else { return stylus };
        for (k, symbol) in STYLUS_SYMBOLS.into_iter().enumerate() {
            let parameter = estimate.parameters.iter().find(|p| p.symbol == symbol);
            let known = parameter.filter(|p| p.identifiable && prior_covariance(estimate, &[symbol]).is_some());
            if let Some(parameter) = known {
                stylus.offset_mm[k] = parameter.value / parameter.unit.to_reported_value(1.0);
                stylus.estimated_coordinate_indices.push(k);
            }
        }
        stylus
    }
}
