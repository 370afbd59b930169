//! Renders templates to lines.

use std::error::Error as _;
use std::f64::consts::TAU;

use super::dialect::Dialect;
use super::error::RenderError;
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};
use minijinja::Error;
use minijinja::value::Value;

/// Largest step number in an N word.
const MAX_STEP_NUMBER: u32 = 99_999;

/// Values for the head and the foot of a program.
#[derive(Debug, Clone, Copy)]
pub struct HeadAndFootValues<'a> {
    /// A comment for a person who reads the program.
    pub title: &'a str,
    /// The machine's axes. Axes without a word in the dialect are omitted.
    pub axes: &'a [Axis],
    /// Absolute path of the results file, if the control itself writes the results.
    pub result_log_path: Option<&'a str>,
}

impl Dialect {
    /// The lines that set all modal state and, if declared, switch the probe on and close the clamps.
    pub fn render_head(&self, program: &HeadAndFootValues) -> Result<Vec<String>, RenderError> {
        render_head_or_foot(self, "head", program)
    }

    /// The lines that, if declared, switch the probe off, and that restore what the head changed, as far as the
    /// language allows.
    pub fn render_foot(&self, program: &HeadAndFootValues) -> Result<Vec<String>, RenderError> {
        render_head_or_foot(self, "foot", program)
    }

    /// The lines of one block; the N words contain the step's id.
    ///
    /// # Errors
    /// A value is not finite, an axis has no word, the control cannot execute the motion, or the step id is above the
    /// largest N word.
    pub fn render_block(&self, block: &MotionBlock) -> Result<Vec<String>, RenderError> {
        if block.step > MAX_STEP_NUMBER {
            return Err(RenderError::StepNumberTooLarge(block.step));
        }
        let mut all = Vec::new();
        for (i, motion) in block.motions.iter().enumerate() {
            let (template, mut names) = motion_template(self, motion)?;
            names.push(("n", Value::from(block.step)));
            names.push(("repeat", Value::from(block.repeat)));
            // Number of the motion within its block.
            names.push(("i", Value::from(i)));
            all.extend(render_template_lines(self, template, names)?);
        }
        Ok(all)
    }

    /// Lines that show `text` to the operator and wait until the operator starts the program again.
    ///
    /// # Errors
    /// The dialect has no template for such a stop, or the step number is too large.
    pub fn render_prompt(&self, step: u32, text: &str) -> Result<Vec<String>, RenderError> {
        if step > MAX_STEP_NUMBER {
            return Err(RenderError::StepNumberTooLarge(step));
        }
        render_template_lines(self, "ask", vec![("n", step.into()), ("text", safe_comment_text(text).into())])
    }

    /// A whole program: head, blocks, foot; each line ends with a newline.
    pub fn render_program(&self, program: &HeadAndFootValues, blocks: &[MotionBlock]) -> Result<String, RenderError> {
        let mut lines = self.render_head(program)?;
        for block in blocks {
            lines.extend(self.render_block(block)?);
        }
        lines.extend(self.render_foot(program)?);
        Ok(lines.into_iter().map(|line| line + "\n").collect())
    }
}

/// Names that a template may use; any other name is undefined, and therefore refused.
type TemplateValues = Vec<(&'static str, Value)>;

fn render_head_or_foot(
    dialect: &Dialect,
    template: &'static str,
    program: &HeadAndFootValues,
) -> Result<Vec<String>, RenderError> {
    let title = safe_comment_text(program.title);
    let axes = program.axes.iter().filter(|axis| dialect.dialect_file.axes.contains(axis));
    let letters: Value = axes.map(|axis| Value::from(axis.letter())).collect();
    let mut names = vec![("title", Value::from(title)), ("axes", letters)];
    names.extend(program.result_log_path.map(|log| ("log", Value::from(log))));
    names.extend(dialect.options.template_values(None));
    render_template_lines(dialect, template, names)
}

/// Replaces every character by a blank, except ASCII letters, digits, blanks and `.,:_/+-`: a bracket would end the
/// comment, and a percent sign the program.
fn safe_comment_text(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || " .,:_/+-".contains(c);
    text.chars().map(|c| if plain(c) { c } else { ' ' }).collect()
}

/// Template of a motion and its names: `to` (axis words), `feed` (mm/min), `s_deg` (0 to 360), `seconds`; with `to`,
/// also the names of `DialectOptions::template_values`.
fn motion_template(dialect: &Dialect, motion: &Motion) -> Result<(&'static str, TemplateValues), RenderError> {
    let moving = |template, to: &Position, feed: Option<f64>| {
        let mut names = vec![("to", axis_word_values(dialect, to)?)];
        names.extend(dialect.options.template_values(Some(to)));
        names.extend(feed.map(|feed| ("feed", Value::from(feed))));
        Ok((template, names))
    };
    match motion {
        Motion::Rapid { to } => moving("rapid", to, None),
        Motion::BackOff { to, feed_mm_min } | Motion::Feed { to, feed_mm_min } => {
            moving("feed", to, Some(*feed_mm_min))
        }
        Motion::Guarded { to, feed_mm_min } => moving("guarded", to, Some(*feed_mm_min)),
        Motion::Probe { to, feed_mm_min } => moving("probe", to, Some(*feed_mm_min)),
        Motion::OrientSpindle { s } => {
            let s_deg = Axis::S.to_mm_or_deg(s.rem_euclid(TAU));
            Ok(("orient", vec![("s_deg", Value::from(s_deg))]))
        }
        Motion::Dwell { seconds } => Ok(("dwell", vec![("seconds", Value::from(*seconds))])),
    }
}

/// Axis words: `letter`, `value` (mm or degrees), `decimals`.
fn axis_word_values(dialect: &Dialect, to: &Position) -> Result<Value, RenderError> {
    if to.is_empty() {
        return Err(RenderError::MotionWithoutTargetAxis);
    }
    let spec = &dialect.dialect_file;
    to.iter()
        .map(|(axis, value)| {
            if !spec.axes.contains(&axis) {
                return Err(RenderError::NoWordForAxis { dialect: spec.name.clone(), axis });
            }
            let decimals = if axis.is_linear() { spec.decimals_mm } else { spec.decimals_deg };
            Ok(Value::from_pairs([
                ("letter", Value::from(axis.letter())),
                ("value", Value::from(axis.to_mm_or_deg(value))),
                ("decimals", Value::from(decimals)),
            ]))
        })
        .collect()
}

fn render_template_lines(
    dialect: &Dialect,
    template: &'static str,
    names: TemplateValues,
) -> Result<Vec<String>, RenderError> {
    let unsupported =
        |_| RenderError::MissingTemplate { dialect: dialect.dialect_file.name.clone(), missing_template: template };
    let found = dialect.templates.get_template(template).map_err(unsupported)?;
    let text = found.render(Value::from_pairs(names)).map_err(|error| render_error_from_template(template, &error))?;
    Ok(text.lines().map(str::to_owned).collect())
}

/// The error of the filter `num` if it is the cause, otherwise an error of the template.
fn render_error_from_template(template: &str, error: &Error) -> RenderError {
    let mut cause = error.source();
    while let Some(inner) = cause {
        if let Some(own) = inner.downcast_ref::<RenderError>() {
            return own.clone();
        }
        cause = inner.source();
    }
    RenderError::TemplateFailed { template: template.to_owned(), reason: error.to_string() }
}
