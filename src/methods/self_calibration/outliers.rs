//! Each touch against all others.

use super::fit::Fit;
use super::parts::Parts;
use crate::identification::{FarMeasurement, LinearFit, RowResiduals, are_alike, outlier_warning};
use machine::record::estimate::{Deviation, Outlier};

/// How each touch is checked by all others.
pub struct TouchCheck<'a> {
    parts: &'a Parts<'a>,
    /// Of each touch the weighted residuals that a deviation by its standard uncertainty leaves.
    patterns: Vec<Vec<f64>>,
    residuals: Vec<f64>,
    leverage: Vec<f64>,
}

impl<'a> TouchCheck<'a> {
    pub fn new(parts: &'a Parts<'a>) -> Self {
        let fit = &parts.fit;
        let patterns = residual_patterns(fit);
        let weighted = fit.residuals().into_iter().zip(&fit.sigma).map(|(r, sigma)| r / sigma);
        let leverage = patterns.iter().enumerate().map(|(i, pattern)| 1.0 - pattern[i]);
        let (residuals, leverage) = (weighted.collect(), leverage.collect());
        Self { parts, patterns, residuals, leverage }
    }

    fn rows(&self) -> RowResiduals<'_> {
        RowResiduals {
            residuals: &self.residuals,
            leverage: &self.leverage,
            dof: self.parts.identification.figures.dof,
            is_declared: self.parts.plan.probe.repeatability_um.is_some(),
            rows: (0..self.residuals.len()).map(|i| i..i + 1).collect(),
        }
    }

    /// Touches that are far from all others. Deviations count along the ray, outward.
    pub fn outliers(&self) -> Vec<Outlier> {
        let mut list: Vec<Outlier> = Vec::new();
        for FarMeasurement { number, t } in self.rows().far_measurements() {
            let own = &self.patterns[number];
            let alike = (0..own.len()).filter(|j| are_alike([own, &self.patterns[*j]]));
            let candidates: Vec<Deviation> = alike.map(|j| self.deviation(j)).collect();
            if list.iter().all(|known| known.candidates != candidates) {
                list.push(Outlier { candidates, t });
            }
        }
        list
    }

    /// If this touch alone is off.
    fn deviation(&self, touch: usize) -> Deviation {
        let alone = self.residuals[touch] / self.patterns[touch][touch];
        let deviation_um = 1e3 * alone * self.parts.fit.sigma[touch];
        Deviation { label: self.label(touch), deviation_um }
    }

    /// What size of a deviation is found.
    pub fn smallest_found(&self) -> Option<String> {
        let rows = self.rows();
        let size = |i: usize| (1e3 * rows.smallest_found(i) * self.parts.fit.sigma[i], i);
        let mut sizes: Vec<(f64, usize)> = (0..self.residuals.len()).map(size).collect();
        sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (middle, (largest, least_checked)) = (sizes.get(sizes.len() / 2)?.0, *sizes.last()?);
        let found = |um: f64| match um.is_finite() {
            true => format!("{um:.1} µm"),
            false => "any size".to_owned(),
        };
        Some(format!(
            "deviations of a single touch below {} (half of the touches) to {} ({}): found with a probability of \
             less than 95 %",
            found(middle),
            found(largest),
            self.label(least_checked)
        ))
    }

    fn label(&self, observation: usize) -> String {
        let id = self.parts.fit.observations[observation].step;
        let step = self.parts.plan.steps.iter().find(|step| step.id == id);
        step.map_or_else(|| id.to_string(), |step| step.label.clone())
    }
}

pub fn in_words(outlier: &Outlier) -> String {
    outlier_warning(outlier, |label| format!("touch {label}"))
}

fn residual_patterns(fit: &Fit) -> Vec<Vec<f64>> {
    let sigma = &fit.sigma[..];
    let linear = LinearFit { x: &fit.x, a: &fit.a, sigma, gain: &fit.solution.gain };
    let pattern = |i: usize| {
        let mut change = vec![0.0; sigma.len()];
        change[i] = sigma[i];
        linear.residual_change(&change)
    };
    (0..sigma.len()).map(pattern).collect()
}
