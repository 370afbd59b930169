//! One measurement of a ball: its touches, and what they say.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::base::{Point, Position};
use crate::estimation::sphere::fit_sphere;
use crate::methods::Refused;
use crate::methods::samba::design::Bench;
use crate::methods::samba::label::{Label, Pass};
use crate::record::artefact::Ball;
use crate::record::plan::{Step, StepKind};
use crate::record::reading::Reading;

const AZIMUTHS: [(&str, f64); 4] =
    [("+45", 45.0), ("-135", -135.0), ("-45", -45.0), ("+135", 135.0)];

/// Which ball is measured, how and where.
pub struct Wanted<'a> {
    pub pass: Pass,
    /// Number of the visit; of a reference its round.
    pub number: usize,
    pub at: &'a Position,
    pub ball: &'a Ball,
    /// Where its centre is thought to be, table frame, mm.
    pub centre: DVec3,
    /// How far from there it may be, mm.
    pub uncertainty_mm: f64,
}

/// What a measurement says, by the nominal machine.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Table frame, mm.
    pub centre: DVec3,
    pub diameter_mm: f64,
    /// Largest residual of a touch, mm.
    pub form_mm: f64,
}

pub fn steps(bench: &Bench<'_>, wanted: &Wanted<'_>) -> Result<Vec<Step>, Refused> {
    let round = AZIMUTHS.iter().map(|(name, degree)| {
        let (sin, cos) = (degree / 360.0 * TAU).sin_cos();
        (*name, DVec3::new(cos, sin, 0.0))
    });
    round
        .chain([("pole", DVec3::Z)])
        .map(|(name, normal)| step(bench, wanted, name, normal))
        .collect()
}

fn step(
    bench: &Bench<'_>,
    wanted: &Wanted<'_>,
    name: &str,
    normal: DVec3,
) -> Result<Step, Refused> {
    let (settings, probe) = (bench.settings, &bench.plan.probe);
    let reach = wanted.ball.radius_mm + probe.ball_radius_mm;
    let chain = bench.model.chain();
    let into_table = chain.machine_from_table(wanted.at, &[]).matrix3.transpose();
    let place = |away: f64| {
        let target = wanted.centre + into_table * normal * (reach + away);
        let linear = chain.linear_axes_for(Point::from_vec(target), bench.tip, wanted.at, &[]);
        linear.map(|linear| wanted.at.updated_by(&linear).as_written()).map_err(|error| Refused {
            why: error.to_string(),
            instead: "correct [axes]".to_owned(),
        })
    };
    let label = Label {
        pass: wanted.pass,
        indexation: wanted.number as u32,
        ball: wanted.ball.id.clone(),
        touch: name.to_owned(),
    };
    let fast = wanted.pass == Pass::Find;
    Ok(Step {
        id: 0,
        stage: 0,
        kind: if wanted.pass == Pass::Reference { StepKind::Reference } else { StepKind::Touch },
        label: label.to_string(),
        from: place(settings.standoff_mm + wanted.uncertainty_mm)?,
        to: place(-if fast { wanted.uncertainty_mm } else { settings.search_mm })?,
        feed_mm_min: if fast { probe.search_feed_mm_min } else { probe.feed_mm_min },
        sensor: "probe".to_owned(),
        normal: normal.to_array(),
    })
}

/// `None`: the touches do not lie on a sphere.
pub fn evaluate(bench: &Bench<'_>, readings: &[&Reading]) -> Option<Measured> {
    let tip = |reading: &&Reading| {
        bench.model.chain().tip_in_table(&reading.position, bench.tip, &[]).mm.to_array()
    };
    let points: Vec<[f64; 3]> = readings.iter().map(tip).collect();
    let found = fit_sphere(&points).ok()?;
    let form_mm = found.residuals.iter().fold(0.0_f64, |most, residual| most.max(residual.abs()));
    Some(Measured {
        centre: DVec3::from_array(found.centre),
        diameter_mm: 2.0 * found.radius,
        form_mm,
    })
}
