//! Touches and samples at any rotary position as points of the workpiece: the machine as a measuring machine (paper 2,
//! Eq. (4); paper 4, section 6).

use nalgebra::Vector3;

use super::uncertainty;
use crate::Refused;
use crate::identification::KnownErrors;
use crate::identification::declared::repeatability_mm;
use machine::frame::{Point, Spindle};
use machine::kinematics::Chain;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use machine::record::sensor::Mount;

/// A point in the table frame (the machine frame when all axes stand at zero), mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorkpiecePoint {
    /// Of a touch the centre of the stylus ball, of a sample the point that the sensor sees.
    pub at_mm: Vector3<f64>,
    /// Standard uncertainty: that of the estimate and the repeatability of a touch.
    pub u_mm: Vector3<f64>,
}

/// Brings the readings of a plan into the table frame.
pub struct WorkpieceFrame<'a> {
    plan: &'a Plan,
    chain: Chain,
    /// `None`: the nominal machine.
    known: Option<KnownErrors<'a>>,
}

impl<'a> WorkpieceFrame<'a> {
    /// # Errors
    /// A machine without kinematics; an estimate without errors of its axes.
    pub fn new(plan: &'a Plan, estimate: Option<&'a Estimate>) -> Result<Self, Refused> {
        let chain = Chain::new(&plan.machine)?;
        let known = estimate.map(|estimate| KnownErrors::of(estimate, &chain)).transpose()?;
        Ok(Self { plan, chain, known })
    }

    /// `None`: a sample without a distance, or of a sensor that is not in the spindle.
    pub fn point(&self, reading: &Reading) -> Option<WorkpiecePoint> {
        let tip = self.in_spindle(reading)?;
        let (errors, parameters) = match &self.known {
            Some(known) => (&known.errors[..], known.parameters()),
            None => (&[][..], Vec::new()),
        };
        let columns = self.chain.jacobian(&reading.position, tip, errors, &parameters);
        let machine = self.known.as_ref().map(|known| uncertainty(&columns, &known.covariance));
        let touch = match reading.value_mm {
            None => repeatability_mm(self.plan),
            Some(_) => 0.0,
        };
        Some(WorkpiecePoint {
            at_mm: self.chain.tip_in_table(&reading.position, tip, errors).mm,
            u_mm: machine.unwrap_or_default().map(|u| u.hypot(touch)),
        })
    }

    fn in_spindle(&self, reading: &Reading) -> Option<Point<Spindle>> {
        let sensor = self.plan.sensors.iter().find(|sensor| sensor.name == reading.sensor);
        let Some(sensor) = sensor else {
            return Some(Point::from_vec(Vector3::from(self.plan.machine.tool_mm)));
        };
        let along = Vector3::from(sensor.direction) * reading.value_mm?;
        (sensor.mount == Mount::Spindle)
            .then(|| Point::from_vec(Vector3::from(sensor.zero_mm) + along))
    }
}
