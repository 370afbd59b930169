//! What a person sees while a run goes on: the touch in hand, the last reading, the time left.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::record::event::Event;

pub struct Progress {
    bar: ProgressBar,
    last: String,
}

impl Progress {
    /// With `quiet`, only faults are said (the estimate goes to standard output as JSON).
    pub fn start(quiet: bool) -> Self {
        let bar = ProgressBar::new(0);
        if quiet {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        if let Ok(style) = ProgressStyle::with_template("  {bar:30} {pos}/{len}  {wide_msg}") {
            bar.set_style(style);
        }
        Self { bar, last: String::new() }
    }

    pub fn tell(&mut self, event: &Event) {
        match event {
            Event::Announced { text } => self.say(text),
            Event::StageStarted { stage } => {
                self.say(&format!("{}: {} touches", stage.name, stage.steps.len()));
                self.bar.set_length(stage.steps.len() as u64);
                self.bar.set_position(0);
            }
            Event::StepStarted { label, remaining_s, .. } => {
                let minutes = (remaining_s / 60.0).floor();
                let seconds = remaining_s % 60.0;
                self.bar.set_message(format!(
                    "{label:<10} left {minutes:.0}:{seconds:02.0}  {}",
                    self.last
                ));
            }
            Event::ReadingStored { reading } => {
                let edge: Vec<String> = reading
                    .position
                    .iter()
                    .map(|(axis, value)| format!("{axis}{:.3}", axis.to_edge(value)))
                    .collect();
                self.last = format!("last {}", edge.join(" "));
                self.bar.inc(1);
            }
            Event::Held { reason } => self.say(&format!("HELD: {reason}")),
            Event::Faulted { what, .. } => self.say(&format!("FAULT: {what}")),
            Event::Finished => {}
        }
    }

    fn say(&self, text: &str) {
        if self.bar.is_hidden() {
            eprintln!("{text}");
        } else {
            self.bar.println(text);
        }
    }

    pub fn end(&self) {
        self.bar.finish_and_clear();
    }
}
