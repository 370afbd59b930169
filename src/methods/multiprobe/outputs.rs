//! Reported quantities: coefficients and curves of the error motions, eccentricity, roundness.

use machine::record::estimate::{FigureKind, Unit};

use super::fit::{HarmonicFit, SeparationFit, is_identifiable};
use super::model::{Component, ProbeLayout};
use super::sources::{StageEccentricity, co_rotating_directions};
use crate::identification::{Curve, Harmonic, Output, Outputs, Spectrum};

/// Points of a curve over one revolution.
const CURVE_POINTS: usize = 120;

/// Derivatives of the cosine and the sine part of one harmonic by the unknowns of that harmonic.
type Parts = [Vec<f64>; 2];

/// The derivatives of all reported quantities by the unknowns.
pub struct ReportedMotions<'a> {
    layout: &'a ProbeLayout,
    fit: &'a SeparationFit,
    /// Components × harmonics from 1 on. `None`: not identifiable.
    parts: Vec<(Component, Vec<Option<Parts>>)>,
    /// Why the first harmonic has no co-rotating part, where it has none.
    pub gauge: Vec<String>,
}

impl<'a> ReportedMotions<'a> {
    pub fn new(layout: &'a ProbeLayout, fit: &'a SeparationFit, stage: StageEccentricity) -> Self {
        let removed = removed_directions(layout, fit, stage);
        let gauge = (!removed.is_empty()).then(|| {
            "the co-rotating first harmonic of (EXC, EYC) and (EAC, EBC) is zero: inseparable from \
             the eccentricity and tilt of the artefact and of the indexing stage"
                .to_owned()
        });
        let harmonics = |column| fit.harmonics.iter().map(move |h| (h, column));
        let of = |(column, component)| {
            let parts =
                harmonics(column).map(|(h, column)| identifiable_parts(h, column, &removed));
            (component, parts.collect())
        };
        let components = layout.components().into_iter().enumerate();
        Self { layout, fit, parts: components.map(of).collect(), gauge: Vec::from_iter(gauge) }
    }

    /// Symbols and harmonics that the rows do not determine.
    pub fn not_identifiable(&self) -> Vec<String> {
        let of = |(component, parts): &(Component, Vec<Option<Parts>>)| {
            let lost = parts.iter().zip(1..).filter(|(parts, _)| parts.is_none());
            let name = |(_, order): (_, usize)| format!("{} harmonic {order}", component.symbol());
            lost.map(name).collect::<Vec<String>>()
        };
        self.parts.iter().flat_map(of).collect()
    }

    /// Of a harmonic from 1 on. `None`: not identifiable.
    pub fn parts(&self, component: Component, order: usize) -> Option<&Parts> {
        let (_, parts) = self.parts.iter().find(|(own, _)| *own == component)?;
        parts.get(order.checked_sub(1)?)?.as_ref()
    }

    pub fn identifiable_orders(&self, component: Component) -> Vec<usize> {
        let orders = 1..=self.fit.harmonics.len();
        orders.filter(|order| self.parts(component, *order).is_some()).collect()
    }

    /// From the unknowns of one harmonic to all.
    fn widened(&self, order: usize, slope: &[f64]) -> Vec<f64> {
        let mut all = vec![0.0; self.fit.x.len()];
        all[self.fit.first_unknown(order)..][..slope.len()].copy_from_slice(slope);
        all
    }

    /// Σ of the identifiable harmonics `orders` at the angle, rad: derivative by all unknowns.
    pub fn slope_at(&self, component: Component, orders: &[usize], angle: f64) -> Vec<f64> {
        let mut sum = vec![0.0; self.fit.x.len()];
        for order in orders {
            let Some(parts) = self.parts(component, *order) else { continue };
            let own = &mut sum[self.fit.first_unknown(*order)..];
            let (sin, cos) = (*order as f64 * angle).sin_cos();
            for (part, factor) in parts.iter().zip([cos, sin]) {
                own.iter_mut().zip(part).for_each(|(sum, slope)| *sum += factor * slope);
            }
        }
        sum
    }

    /// The motion at the angle, rad.
    pub fn value_at(&self, component: Component, orders: &[usize], angle: f64) -> f64 {
        let slope = self.slope_at(component, orders, angle);
        slope.iter().zip(&self.fit.x).map(|(s, x)| s * x).sum()
    }

    fn curve(&self, component: Component) -> Curve {
        let mut orders = self.identifiable_orders(component);
        orders.retain(|order| *order > 1 || !matches!(component, Component::Roundness(_)));
        let x: Vec<f64> =
            (0..=CURVE_POINTS).map(|i| i as f64 * 360.0 / CURVE_POINTS as f64).collect();
        let slope = |degrees: &f64| self.slope_at(component, &orders, degrees.to_radians());
        let value = |degrees: &f64| self.value_at(component, &orders, degrees.to_radians());
        Curve {
            symbol: component.symbol(),
            argument: "C",
            argument_unit: "deg",
            y: x.iter().map(value).collect(),
            slopes: x.iter().map(slope).collect(),
            x,
            unit: unit(component),
            figure: FigureKind::Polar,
        }
    }

    fn coefficients(&self, component: Component) -> Vec<Output> {
        let of = |order: usize| {
            let parts = self.parts(component, order).into_iter().flatten().zip(["c", "s"]);
            let symbol = |part: &str| format!("{}_{part}{order}", component.symbol());
            let output = |(slope, part): (&Vec<f64>, &str)| {
                let slope = self.widened(order, slope);
                Output::linear(&symbol(part), unit(component), slope, &self.fit.x)
            };
            parts.map(output).collect::<Vec<_>>()
        };
        (1..=self.fit.harmonics.len()).flat_map(of).collect()
    }

    /// Centre of a section against the table's axis at the first index and q = 0. It contains the
    /// co-rotating error motion.
    fn eccentricity(&self, section: usize) -> Vec<Output> {
        let (layout, sign) = (self.layout, self.layout.sense.sign());
        let lever = layout.section_z_mm[section] - layout.reference_z_mm;
        let form = layout.components().iter().position(|c| *c == Component::Roundness(section));
        let index_angle = layout.index_angles_rad.first().copied().unwrap_or(0.0);
        let (sin, cos) = index_angle.sin_cos();
        let offset = co_rotating_directions(layout, Component::X, Component::Y);
        let tilt = co_rotating_directions(layout, Component::A, Component::B);
        let slope = |axis: usize, lever: f64, of_form: [f64; 2]| {
            let mut slope: Vec<f64> = offset[axis].iter().map(|d| d / 2.0).collect();
            let tilt = tilt.get(1 - axis).into_iter().flatten();
            slope.iter_mut().zip(tilt).for_each(|(slope, d)| *slope += lever * d / 2.0);
            form.into_iter().for_each(|j| slope[2 * j..2 * j + 2].copy_from_slice(&of_form));
            slope
        };
        let output = |axis: &str, slope: Vec<f64>| {
            let symbol = format!("ecc_{axis}{}", section + 1);
            Output::linear(&symbol, Unit::Um, self.widened(1, &slope), &self.fit.x)
        };
        vec![
            output("X", slope(0, lever, [cos, sign * sin])),
            output("Y", slope(1, -lever, [sin, -sign * cos])),
        ]
    }

    /// Coefficients, eccentricities and curves: what is linear in the unknowns.
    pub fn linear_outputs(&self) -> Outputs {
        let components = self.layout.components();
        let is_form = |c: &Component| matches!(c, Component::Roundness(_) | Component::Face);
        let motions = components.iter().filter(|c| !is_form(c));
        let has_curve =
            |c: &&Component| **c != Component::Face && !self.identifiable_orders(**c).is_empty();
        let curves = components.iter().filter(has_curve);
        let sections = 0..self.layout.section_z_mm.len();
        let mut parameters: Vec<Output> = motions.flat_map(|c| self.coefficients(*c)).collect();
        parameters.extend(sections.flat_map(|section| self.eccentricity(section)));
        Outputs {
            parameters,
            curves: curves.map(|component| self.curve(*component)).collect(),
            nonlinear: None,
        }
    }

    /// Amplitudes of each motion over the orders that are identifiable.
    pub fn spectra(&self) -> Vec<Spectrum> {
        let is_form = |c: &Component| matches!(c, Component::Roundness(_) | Component::Face);
        let motions = self.layout.components().into_iter().filter(|c| !is_form(c));
        let harmonic = |component: Component, order: usize| {
            let [cos, sin] = self.parts(component, order)?;
            let parts = [self.widened(order, cos), self.widened(order, sin)];
            Some(Harmonic { order: order as f64, parts })
        };
        let spectrum = |component: Component| {
            let orders = self.identifiable_orders(component).into_iter();
            let harmonics = orders.filter_map(|order| harmonic(component, order)).collect();
            let symbol = format!("{}_spectrum", component.symbol());
            Spectrum { symbol, unit: unit(component), harmonics }
        };
        motions.map(spectrum).filter(|spectrum| !spectrum.harmonics.is_empty()).collect()
    }

    pub fn solution(&self) -> &[f64] {
        &self.fit.x
    }
}

pub fn unit(component: Component) -> Unit {
    match component {
        Component::A | Component::B => Unit::Urad,
        _ => Unit::Um,
    }
}

/// Orthogonal directions of the first harmonic that no motion contains: its co-rotating part, unless the
/// rows determine it and the stage is declared.
fn removed_directions(
    layout: &ProbeLayout,
    fit: &SeparationFit,
    stage: StageEccentricity,
) -> Vec<Vec<f64>> {
    let pairs = [(Component::X, Component::Y), (Component::A, Component::B)];
    let co_rotating = |(a, b)| co_rotating_directions(layout, a, b);
    let directions: Vec<Vec<f64>> = pairs.into_iter().flat_map(co_rotating).collect();
    let is_determined = |direction: &Vec<f64>| {
        fit.harmonics.first().is_none_or(|first| is_identifiable(direction, &first.null_space))
    };
    let is_declared = stage != StageEccentricity::NotDeclared;
    if is_declared && directions.iter().all(is_determined) { Vec::new() } else { directions }
}

fn identifiable_parts(fit: &HarmonicFit, column: usize, removed: &[Vec<f64>]) -> Option<Parts> {
    let part = |offset: usize| {
        let mut slope = vec![0.0; fit.design.ncols()];
        slope[2 * column + offset] = 1.0;
        if fit.order == 1 {
            removed.iter().for_each(|direction| remove(&mut slope, direction));
        }
        is_identifiable(&slope, &fit.null_space).then_some(slope)
    };
    Some([part(0)?, part(1)?])
}

/// Removes the part along `direction`.
fn remove(slope: &mut [f64], direction: &[f64]) {
    let square: f64 = direction.iter().map(|d| d * d).sum();
    let along: f64 = slope.iter().zip(direction).map(|(s, d)| s * d).sum::<f64>() / square;
    slope.iter_mut().zip(direction).for_each(|(s, d)| *s -= along * d);
}
