//! Sentences about the fit that are the same for all methods.

use estimation::misfit::Misfit;

use super::Identification;
use super::likely::LikelySource;

/// Method-specific parts of the sentence about a misfit.
pub struct MisfitAdvice {
    /// Quantities that may scatter more than declared.
    pub causes: &'static str,
    /// The settings that declare the scatter of the measurements.
    pub declared_by: &'static str,
}

impl Identification {
    /// Warning if the residuals are larger or smaller than the declared sources explain.
    pub fn misfit_warning(&self, advice: &MisfitAdvice) -> Option<String> {
        let Misfit { above, below, factor, .. } = self.propagation.misfit;
        let (expectation, MisfitAdvice { causes, declared_by }) = (self.expectation(), advice);
        let likely = self.likely_in_words();
        let more = || {
            format!(
                "the model does not explain the measurements: they scatter {factor:.1} times more than \
                 declared ({expectation}); look for {causes}{likely}. The uncertainties are enlarged by that \
                 factor, which need not cover what the model does not hold"
            )
        };
        let less = || {
            format!(
                "the measurements scatter less than declared ({expectation}): {declared_by} may be stated \
                 too large, and the uncertainties with it"
            )
        };
        above.then(more).or_else(|| below.then(less))
    }

    /// The sources that would explain the residuals if they were larger, the most likely first.
    fn likely_in_words(&self) -> String {
        let word = |source: &LikelySource| {
            format!("{}, {:.1} times as large as declared", source.name, source.factor)
        };
        match self.likely.iter().map(word).collect::<Vec<_>>() {
            none if none.is_empty() => String::new(),
            words => {
                format!(". It would be explained, most likely first, by: {}", words.join("; "))
            }
        }
    }

    /// χ² and its expectation for the declared sources, in words.
    fn expectation(&self) -> String {
        let Misfit { chi2, expected, .. } = self.propagation.misfit;
        let dof = self.figures.dof;
        let mut text = format!("χ² {chi2:.1} where {expected:.0} is expected");
        if (expected - dof as f64).abs() >= 0.5 {
            text += &format!(
                ", not the {dof} degrees of freedom: sources that move many measurements together \
                 leave other residuals than those that move each alone"
            );
        }
        text
    }

    /// Warning if first-order propagation and trials contradict each other.
    pub fn trials_warning(&self) -> Option<String> {
        let symbols = self.contradicted();
        (!symbols.is_empty()).then(|| {
            format!(
                "first-order and Monte Carlo uncertainty disagree (JCGM 101, 8): {}; the estimate has both",
                symbols.join(", ")
            )
        })
    }
}
