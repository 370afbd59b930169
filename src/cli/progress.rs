//! Progress of a run on the terminal: the current touch, the last reading, the remaining time.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::live_values::live_value_lines;
use machine::record::event::RunEvent;

/// Template of the progress bar while steps are measured.
const STEP_BAR_TEMPLATE: &str = "  {bar:14} {pos:>2}/{len}  {wide_msg}";
/// Template of the progress bar while sensors are watched.
const SENSOR_BAR_TEMPLATE: &str = "{msg}";

pub struct ProgressDisplay {
    bar: ProgressBar,
    last_reading_text: String,
}

impl ProgressDisplay {
    /// Starts the display; with `is_hidden`, no bar is drawn (the estimate goes to standard output as JSON).
    pub fn start(is_hidden: bool) -> Self {
        let bar = ProgressBar::new(0);
        if is_hidden {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let progress = Self { bar, last_reading_text: String::new() };
        progress.set_template(STEP_BAR_TEMPLATE);
        progress
    }

    fn set_template(&self, template: &str) {
        if let Ok(style) = ProgressStyle::with_template(template) {
            self.bar.set_style(style);
        }
    }

    pub fn show_event(&mut self, event: &RunEvent) {
        match event {
            RunEvent::ControlPrepared { identity: text } | RunEvent::OperatorMessage { text } => self.print_line(text),
            RunEvent::StageStarted { stage } => {
                self.print_line(&format!("{}: {} steps", stage.name, stage.steps.len()));
                self.bar.set_length(stage.steps.len() as u64);
                self.bar.set_position(0);
            }
            RunEvent::StageProven { proof, .. } => {
                if let Some(near) = &proof.nearest {
                    let [one, other] = &near.between;
                    self.print_line(&format!(
                        "collision check passed: smallest clearance {:.2} mm ({one} and {other}, step {})",
                        near.clearance_mm, near.step
                    ));
                }
            }
            RunEvent::Acknowledged { who, what, .. } => self.print_line(&format!("confirmed by {who}: {what}")),
            RunEvent::Resumed { .. } => self.print_line("the run is resumed; the references are measured first"),
            RunEvent::StepStarted { label, remaining_s, .. } => {
                let left = format_minutes_and_seconds(*remaining_s);
                self.bar.set_message(format!("{label:<12} remaining {left:>5}  {}", self.last_reading_text));
            }
            RunEvent::ReadingStored { reading } => {
                // The label of the step states the rotary positions: only the linear axes are printed.
                let edge: Vec<String> = reading
                    .position
                    .iter()
                    .filter(|(axis, _)| axis.is_linear())
                    .map(|(axis, value)| format!("{axis}{:.3}", axis.to_mm_or_deg(value)))
                    .collect();
                self.last_reading_text = format!("last {}", edge.join(" "));
                self.bar.inc(1);
            }
            RunEvent::ScanStored { samples, flagged, .. } => {
                self.last_reading_text = format!("last {samples} samples, {flagged} flagged");
                self.bar.inc(1);
            }
            // The source of the answer shows the prompt.
            RunEvent::PromptStarted { .. } => self.bar.set_message("waiting for the operator"),
            // Displayed on a terminal only: a log file would grow while the operator works.
            RunEvent::Watched { values } => {
                self.set_template(SENSOR_BAR_TEMPLATE);
                self.bar.set_message(live_value_lines(values));
            }
            RunEvent::PromptConfirmed { who, .. } => {
                self.set_template(STEP_BAR_TEMPLATE);
                self.bar.set_message("");
                self.print_line(&format!("confirmed by {who}"));
                self.bar.inc(1);
            }
            // The command prints the reason and the remedy at its end.
            RunEvent::Held { .. } | RunEvent::Faulted { .. } | RunEvent::Finished => self.bar.finish_and_clear(),
            // The last event occurs long after the run.
            RunEvent::ToolCentreRead { .. } | RunEvent::SamplesRemoved { .. } => {}
        }
    }

    /// Printer of lines above the bar, usable from any thread.
    pub fn line_printer(&self) -> impl Fn(&str) + Send + Sync + use<> {
        let bar = self.bar.clone();
        move |text| match bar.is_hidden() {
            true => errln!("{}", text),
            false => bar.println(text),
        }
    }

    fn print_line(&self, text: &str) {
        self.line_printer()(text);
    }
}

/// Formats a time as m:ss, rounded up, so that a remaining time is never shown as zero.
fn format_minutes_and_seconds(seconds: f64) -> String {
    let whole = seconds.ceil();
    format!("{:.0}:{:02.0}", (whole / 60.0).floor(), whole % 60.0)
}
