//! Touches and samples at any rotary position as points of the workpiece: the machine tool as a coordinate
//! measuring machine (paper 2, Eq. (4); paper 4, section 6).

use faer::Mat;
use nalgebra::Vector3;

use super::uncertainty;
use crate::Refused;
use crate::identification::declared::point_mm;
use crate::identification::{KnownErrors, prior_covariance};
use machine::frame::{Point, Spindle};
use machine::kinematics::Chain;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use machine::record::sensor::Mount;

/// A point in the table frame (the machine frame with all axes at zero), mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorkpiecePoint {
    /// Centre of the stylus ball of a touch, or the measured point of a sensor sample.
    pub at_mm: Vector3<f64>,
    /// Standard uncertainty from the estimate with its stylus, and from what the plan declares of probe and
    /// axes for one point.
    pub u_mm: Vector3<f64>,
}

/// Position of the stylus ball centre relative to the spindle datum, mm.
struct Stylus {
    mm: Vector3<f64>,
    /// Indices of the coordinates that the estimate contains: 0 for x to 2 for z.
    found: Vec<usize>,
}

const STYLUS: [&str; 3] = ["tool_x", "tool_y", "tool_z"];

/// Transforms the readings of a plan into the table frame.
pub struct WorkpieceFrame<'a> {
    plan: &'a Plan,
    chain: Chain,
    /// Errors of the axes. `None`: the nominal machine.
    known: Option<KnownErrors<'a>>,
    stylus: Stylus,
    /// Covariance of the errors, followed by the estimated stylus coordinates, internal units.
    covariance: Mat<f64>,
}

impl<'a> WorkpieceFrame<'a> {
    /// # Errors
    /// The machine has no kinematics; the estimate has no errors of its axes.
    pub fn new(plan: &'a Plan, estimate: Option<&'a Estimate>) -> Result<Self, Refused> {
        let chain = Chain::new(&plan.machine)?;
        let known = estimate.map(|estimate| KnownErrors::of(estimate, &chain)).transpose()?;
        let stylus = Stylus::of(plan, estimate);
        let symbols = known.iter().flat_map(|known| known.symbols.iter().copied());
        let symbols: Vec<&str> = symbols.chain(stylus.found.iter().map(|k| STYLUS[*k])).collect();
        let covariance = estimate.and_then(|estimate| prior_covariance(estimate, &symbols));
        Ok(Self { plan, chain, known, stylus, covariance: covariance.unwrap_or_else(Mat::new) })
    }

    /// Origin of the stylus coordinates, in words.
    pub fn stylus_in_words(&self) -> String {
        match self.stylus.found.len() {
            0 => "stylus as stated in the machine file, to stylus_offset_um in each coordinate"
                .to_owned(),
            3 => "stylus as the estimate has it".to_owned(),
            _ => {
                let names: Vec<&str> = self.stylus.found.iter().map(|k| STYLUS[*k]).collect();
                format!("{} of the estimate, the rest of the stylus as stated", names.join(", "))
            }
        }
    }

    /// The reading as a point. `None`: the sample has no distance, or its sensor is not in the spindle.
    pub fn point(&self, reading: &Reading) -> Option<WorkpiecePoint> {
        let tip = self.in_spindle(reading)?;
        let (errors, parameters) = match &self.known {
            Some(known) => (&known.errors[..], known.parameters()),
            None => (&[][..], Vec::new()),
        };
        let at =
            |point: Point<Spindle>| self.chain.tip_in_table(&reading.position, point, errors).mm;
        let mut columns = self.chain.jacobian(&reading.position, tip, errors, &parameters);
        let is_touch = reading.value_mm.is_none();
        let by_stylus = |k: usize| at(Point::from_vec(tip.mm + Vector3::ith(k, 1.0))) - at(tip);
        let (found, stated): (Vec<usize>, Vec<usize>) =
            (0..3).partition(|k| self.stylus.found.contains(k));
        let none = Vector3::zeros;
        columns.extend(found.into_iter().map(|k| if is_touch { by_stylus(k) } else { none() }));
        let offset_mm = if is_touch { self.plan.probe.stylus_offset_um * 1e-3 } else { 0.0 };
        let own = point_mm(self.plan, is_touch, reading.t_s).powi(2);
        let own = stated.into_iter().fold(Vector3::repeat(own), |sum, k| {
            sum + (by_stylus(k) * offset_mm).map(|mm| mm * mm)
        });
        let variance = uncertainty(&columns, &self.covariance).map(|u| u * u) + own;
        Some(WorkpiecePoint { at_mm: at(tip), u_mm: variance.map(f64::sqrt) })
    }

    fn in_spindle(&self, reading: &Reading) -> Option<Point<Spindle>> {
        let sensor = self.plan.sensors.iter().find(|sensor| sensor.name == reading.sensor);
        let Some(sensor) = sensor else {
            return Some(Point::from_vec(self.stylus.mm));
        };
        let along = Vector3::from(sensor.direction) * reading.value_mm?;
        (sensor.mount == Mount::Spindle)
            .then(|| Point::from_vec(Vector3::from(sensor.zero_mm) + along))
    }
}

impl Stylus {
    /// The stylus of the estimate; coordinates that the estimate does not contain with their covariance come
    /// from the machine file.
    fn of(plan: &Plan, estimate: Option<&Estimate>) -> Self {
        let mut stylus = Self { mm: Vector3::from(plan.machine.tool_mm), found: Vec::new() };
        let Some(estimate) = estimate else { return stylus };
        for (k, symbol) in STYLUS.into_iter().enumerate() {
            let parameter = estimate.parameters.iter().find(|p| p.symbol == symbol);
            let known = parameter
                .filter(|p| p.identifiable && prior_covariance(estimate, &[symbol]).is_some());
            if let Some(parameter) = known {
                stylus.mm[k] = parameter.value / parameter.unit.from_internal(1.0);
                stylus.found.push(k);
            }
        }
        stylus
    }
}
