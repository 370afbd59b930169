//! Latch delay of a contact, from touches of one position of the part at two alternating feeds. A latch that is τ
//! late records the axes v·τ too far, so the position over the feed is a line with slope τ. A PLC that reads the
//! probe once per scan of duration T is late by 0 to T, on average T/2. Its touches scatter by v·T/√12
//! (rectangular, GUM 4.3.7), which grows with the feed, unlike the scatter of the probe.

mod estimate;
mod feeds;
mod fit;
mod observe;
mod outputs;
mod plan;
mod scan;
mod settings;
mod words;

pub use scan::{Latch, Time};
pub use settings::Settings;

use self::feeds::Feeds;
use self::fit::Fitted;
use self::observe::Observed;
use self::plan::Place;
use self::scan::Scan;
use super::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use machine::artefact::uncertainty_mm;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const NAME: &str = "latch-delay";

pub struct LatchDelay {
    settings: Settings,
}

impl LatchDelay {
    fn feeds(&self, plan: &Plan) -> Result<Feeds, Refused> {
        let uncertainty = uncertainty_mm(&plan.artefact);
        let length = |room_mm| plan::length_mm(uncertainty, room_mm);
        Feeds::choose((&plan.machine, &plan.probe), &self.settings, length)
    }
}

impl Registered for LatchDelay {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "a round part or balls",
        finds: "how late a contact is latched, whether a PLC's scan lies between, how \
                touches scatter: one place, touched at two feeds",
        machine_file: "simulated.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

impl Method for LatchDelay {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        self.settings.check()?;
        let feeds = self.feeds(plan)?;
        let place = Place::choose(plan, &self.settings, &feeds)?;
        let (id, name, new_steps) = match done.len() {
            0 => (0, "search".to_owned(), vec![place.search(plan.probe.search_feed_mm_min)]),
            1 => {
                if let Source::Measured(readings) = source {
                    observe::check_found(plan, &feeds, readings)?;
                }
                let name = format!("{} and {} mm/min", feeds.measuring_mm_min, feeds.fast_mm_min);
                (1, name, place.alternating(&feeds, self.settings.touches))
            }
            _ => return Ok(Next::Done),
        };
        let steps = new_steps.iter().map(|step| step.id).collect();
        Ok(Next::Stage { stage: Stage { id, name, repeat: 0, steps, found: None }, new_steps })
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let (observed, fitted, scan) = look(plan, readings)?;
        Ok(estimate::estimate(plan, &observed, &fitted, &scan))
    }
}

fn look(plan: &Plan, readings: &[Reading]) -> Result<(Observed, Fitted, Scan), IdentifyError> {
    let observed = observe::observe(plan, readings)?;
    let fitted = fit::fit(&observed)?;
    let scan = scan::judge(&observed, &fitted);
    Ok((observed, fitted, scan))
}

/// Results of a run for the check of the machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    pub latch: Latch,
    pub latch_in_words: String,
    /// Latch delay, s, positive if late.
    pub delay_s: f64,
    /// Description of a delay that exceeds its uncertainty.
    pub delay_in_words: Option<String>,
    /// Description of slow touches that scatter more than declared.
    pub scatter_in_words: Option<String>,
    /// Standard deviation of a slow touch, mm.
    pub scatter_mm: f64,
    /// Largest scatter of so few touches that does not contradict the declared one, mm.
    pub scatter_bound_mm: Option<f64>,
}

impl Found {
    /// # Errors
    /// The errors of [`Method::identify`].
    pub fn of(plan: &Plan, readings: &[Reading]) -> Result<Self, IdentifyError> {
        let (observed, fitted, scan) = look(plan, readings)?;
        let declared_mm = estimate::declared_mm(plan, &observed);
        Ok(Self {
            latch: scan.latch,
            latch_in_words: words::of_latch(&observed, &fitted, &scan),
            delay_s: fitted.delay_s,
            delay_in_words: words::of_delay(&observed, &fitted),
            scatter_in_words: words::of_scatter(&observed, &fitted, &scan, declared_mm),
            scatter_mm: fitted.scatter[0].s_mm,
            scatter_bound_mm: declared_mm
                .and_then(|mm| words::scatter_bound_mm(&observed, &fitted, &scan, mm)),
        })
    }
}
