//! Sentences about the fit that are the same for all methods.

use estimation::misfit::Misfit;

use super::Identification;
use super::misfit_causes::LikelyMisfitCause;

/// Method-specific parts of the sentence about a misfit.
pub struct MisfitAdvice {
    /// Quantities that may scatter more than declared.
    pub possible_causes: &'static str,
    /// The settings that declare the scatter of the measurements.
    pub declaring_settings: &'static str,
}

impl Identification {
    /// Warning if the residuals are larger or smaller than the declared sources explain.
    pub fn misfit_warning(&self, advice: &MisfitAdvice) -> Option<String> {
        let Misfit { is_above_bound: above, is_below_bound: below, uncertainty_factor: factor, .. } =
            self.propagation.misfit;
        let (expectation, MisfitAdvice { possible_causes: causes, declaring_settings }) =
            (self.describe_expected_chi2(), advice);
        let likely = self.describe_misfit_causes();
        let more = || {
            format!(
                "the model does not explain the measurements: the scatter is {factor:.1} times the declared \
                scatter ({expectation}); check for {causes}{likely}. The uncertainties are multiplied by \
                this factor; errors outside the model may still exceed them"
            )
        };
        let less = || {
            format!(
                "the measurements scatter less than declared ({expectation}): {declaring_settings} may be \
                too large, and U as well"
            )
        };
        above.then(more).or_else(|| below.then(less))
    }

    /// The sources that would explain the residuals if they were larger, the most likely first.
    fn describe_misfit_causes(&self) -> String {
        let word = |source: &LikelyMisfitCause| {
            format!("{}, {:.1} times as large as declared", source.name, source.size_factor)
        };
        match self.likely_misfit_causes.iter().map(word).collect::<Vec<_>>() {
            none if none.is_empty() => String::new(),
            words => {
                format!(". Possible causes, most likely first: {}", words.join("; "))
            }
        }
    }

    /// χ² and its expectation for the declared sources, in words.
    fn describe_expected_chi2(&self) -> String {
        let Misfit { chi2, expected_chi2: expected, .. } = self.propagation.misfit;
        let dof = self.fit_quality.dof;
        let mut text = format!("χ² {chi2:.1} where {expected:.0} is expected");
        if (expected - dof as f64).abs() >= 0.5 {
            text +=
                &format!(", not the {dof} degrees of freedom, because some sources change many measurements together");
        }
        text
    }

    /// Warning if first-order propagation and trials contradict each other.
    pub fn trial_contradiction_warning(&self) -> Option<String> {
        let symbols = self.symbols_contradicted_by_trials();
        (!symbols.is_empty()).then(|| {
            format!(
                "first-order and Monte Carlo uncertainty disagree (JCGM 101, 8): {}; the estimate has both",
                symbols.join(", ")
            )
        })
    }
}
