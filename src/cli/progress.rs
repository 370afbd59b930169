//! Progress of a run on the terminal: the current touch, the last reading, the remaining time.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::live_values::lines;
use machine::record::event::Event;

/// Templates of the progress bar: while steps are measured, and while sensors are watched.
const STEPS: &str = "  {bar:14} {pos:>2}/{len}  {wide_msg}";
const SENSORS: &str = "{msg}";

pub struct Progress {
    bar: ProgressBar,
    last: String,
}

impl Progress {
    /// Starts the display; with `quiet`, no bar is drawn (the estimate goes to standard output as JSON).
    pub fn start(quiet: bool) -> Self {
        let bar = ProgressBar::new(0);
        if quiet {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let progress = Self { bar, last: String::new() };
        progress.draw_as(STEPS);
        progress
    }

    fn draw_as(&self, template: &str) {
        if let Ok(style) = ProgressStyle::with_template(template) {
            self.bar.set_style(style);
        }
    }

    pub fn tell(&mut self, event: &Event) {
        match event {
            // Identity and stopping method of the control, each on a line of its own.
            Event::Announced { text } => text.split("; ").for_each(|line| self.say(line)),
            Event::StageStarted { stage } => {
                self.say(&format!("{}: {} steps", stage.name, stage.steps.len()));
                self.bar.set_length(stage.steps.len() as u64);
                self.bar.set_position(0);
            }
            Event::StageProven { proof, .. } => {
                if let Some(near) = &proof.nearest {
                    let [one, other] = &near.between;
                    self.say(&format!(
                        "proven: nothing nearer than {:.2} mm ({one} and {other}, step {})",
                        near.clearance_mm, near.step
                    ));
                }
            }
            Event::Acknowledged { who, what, .. } => {
                self.say(&format!("acknowledged by {who}: {what}"))
            }
            Event::Resumed { .. } => self.say("the run goes on, references first"),
            Event::StepStarted { label, remaining_s, .. } => {
                let left = minutes(*remaining_s);
                self.bar.set_message(format!("{label:<12} left {left:>5}  {}", self.last));
            }
            Event::ReadingStored { reading } => {
                // The current touch is named by its rotary positions; they are left out here.
                let edge: Vec<String> = reading
                    .position
                    .iter()
                    .filter(|(axis, _)| axis.is_linear())
                    .map(|(axis, value)| format!("{axis}{:.3}", axis.to_edge(value)))
                    .collect();
                self.last = format!("last {}", edge.join(" "));
                self.bar.inc(1);
            }
            Event::ScanStored { samples, flagged, .. } => {
                self.last = format!("last {samples} samples, {flagged} flagged");
                self.bar.inc(1);
            }
            // The source of the answer shows the prompt.
            Event::Asked { .. } => self.bar.set_message("a person is asked"),
            // On a terminal only: a log would grow for as long as the operator works.
            Event::Watched { values } => {
                self.draw_as(SENSORS);
                self.bar.set_message(lines(values));
            }
            Event::Answered { who, .. } => {
                self.draw_as(STEPS);
                self.bar.set_message("");
                self.say(&format!("done, says {who}"));
                self.bar.inc(1);
            }
            // The command prints the reason and the remedy at its end.
            Event::Held { .. } | Event::Faulted { .. } | Event::Finished => self.end(),
            // This event occurs long after the run.
            Event::SamplesRemoved { .. } => {}
        }
    }

    /// Printer of lines above the bar, usable from any thread.
    pub fn printer(&self) -> impl Fn(&str) + Send + Sync + use<> {
        let bar = self.bar.clone();
        move |text| match bar.is_hidden() {
            true => tell!("{}", text),
            false => bar.println(text),
        }
    }

    fn say(&self, text: &str) {
        self.printer()(text);
    }

    fn end(&self) {
        self.bar.finish_and_clear();
    }
}

/// m:ss, rounded up, so that a remaining time is never shown as zero.
fn minutes(seconds: f64) -> String {
    let whole = seconds.ceil();
    format!("{:.0}:{:02.0}", (whole / 60.0).floor(), whole % 60.0)
}
