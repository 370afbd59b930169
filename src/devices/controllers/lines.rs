//! What is sent of a block, where a control takes lines: the very lines of a program that was proven to
//! say what it means.

use crate::controllers::ControllerError;
use machine::Axis;
use machine::record::motion::{Block, Motion};
use planning::gcode::{Dialect, Program};

/// One motion and the lines that say it.
pub(in crate::controllers) struct Lines<'a> {
    pub step: u32,
    pub motion: &'a Motion,
    pub text: Vec<String>,
}

/// The lines of each motion of `block`, for a control that takes lines shorter than `limit` bytes.
///
/// # Errors
/// A program that does not say what the block means, or that no buffer takes: nothing is sent.
pub(in crate::controllers) fn of<'a>(
    block: &'a Block,
    dialect: &Dialect,
    axes: &[Axis],
    limit: usize,
) -> Result<Vec<Lines<'a>>, ControllerError> {
    let fault = |why: String| ControllerError::Render { step: block.step, why };
    let proven = proven(block, dialect, axes).map_err(fault)?;
    let mut all = Vec::new();
    for motion in &block.motions {
        let unit = Block { motions: vec![motion.clone()], ..*block };
        let text = dialect.block(&unit).map_err(|error| fault(error.to_string()))?;
        all.push(Lines { step: block.step, motion, text });
    }
    if !all.iter().flat_map(|lines| &lines.text).eq(&proven) {
        let why = "its motions one by one read otherwise than the program that was proven";
        return Err(fault(why.to_owned()));
    }
    match proven.iter().find(|line| line.len() >= limit) {
        Some(line) => Err(fault(format!("a line is longer than the control's buffer: `{line}`"))),
        None => Ok(all),
    }
}

/// A whole program that was proven to mean the block.
///
/// # Errors
/// In words.
pub(in crate::controllers) fn program(
    block: &Block,
    dialect: &Dialect,
    axes: &[Axis],
) -> Result<String, String> {
    let title = format!("step {} repeat {}", block.step, block.repeat);
    let program = Program { title: &title, axes, log: None };
    let blocks = std::slice::from_ref(block);
    let text = dialect.program(&program, blocks).map_err(|error| error.to_string())?;
    dialect.proves(&text, blocks).map_err(|error| error.to_string())?;
    Ok(text)
}

/// The block's own lines in it.
fn proven(block: &Block, dialect: &Dialect, axes: &[Axis]) -> Result<Vec<String>, String> {
    let text = self::program(block, dialect, axes)?;
    let program = Program { title: "", axes, log: None };
    let frame = |lines: Result<Vec<String>, _>| lines.map(|lines| lines.len());
    let head = frame(dialect.head(&program)).map_err(|error| error.to_string())?;
    let foot = frame(dialect.foot(&program)).map_err(|error| error.to_string())?;
    let count = text.lines().count().saturating_sub(head + foot);
    Ok(text.lines().skip(head).take(count).map(str::to_owned).collect())
}
