//! Transmission of text to a control, and the text of blocks in the form in which it is sent.

use super::dialect::Dialect;
use super::error::RenderError;
use super::render::HeadAndFootValues;
use machine::Axis;
use machine::record::motion::{Motion, MotionBlock};

/// Form in which a control receives blocks. The driver declares it; the proof reads exactly the text that is sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TransmissionForm {
    /// Single lines, each shorter than `max_line_bytes` without its newline. The modes that the head sets remain
    /// active until the foot.
    Lines { max_line_bytes: usize },
    /// A program with a head and a foot for each part of a block. A part ends after a back-off, because the probe
    /// must read open before the next move. The control writes its results to the file `log`.
    Programs { log: String },
    /// Rows of a table that a program in the control executes: the motions as read back from the text.
    TableRows,
}

/// Text that is sent at once: the lines of one motion, or one program.
#[derive(Debug, Clone, PartialEq)]
pub struct TransmissionUnit {
    pub motions: Vec<Motion>,
    /// Each line ends with a newline.
    pub text: String,
    /// Total waiting time of the clamps in the unit, s.
    pub clamp_wait_s: f64,
}

/// Blocks in the form in which they are sent.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TransmissionText {
    /// The units of each block.
    pub units_by_block: Vec<Vec<TransmissionUnit>>,
    /// The programs that the G-code reader must read back, each from an unknown state: the whole text, in the order of
    /// transmission.
    pub programs_to_read_back: Vec<String>,
    /// Number of lines before the first unit in the program of `Lines` and `TableRows`; 0 for `Programs`.
    pub head_line_count: usize,
}

impl Dialect {
    /// Renders the text of `blocks` for `transmission`.
    ///
    /// # Errors
    /// A block cannot be rendered.
    pub(crate) fn render_for_transmission(
        &self,
        transmission: &TransmissionForm,
        axes: &[Axis],
        blocks: &[MotionBlock],
    ) -> Result<TransmissionText, RenderError> {
        match transmission {
            TransmissionForm::Lines { .. } | TransmissionForm::TableRows => self.render_unit_per_motion(axes, blocks),
            TransmissionForm::Programs { log } => self.render_program_per_block_part(axes, log, blocks),
        }
    }

    /// Renders one program, with a unit for each motion.
    fn render_unit_per_motion(&self, axes: &[Axis], blocks: &[MotionBlock]) -> Result<TransmissionText, RenderError> {
        let program = HeadAndFootValues { title: "stage", axes, result_log_path: None };
        let mut text = join_lines(self.render_head(&program)?);
        let head_lines = text.lines().count();
        let mut all = Vec::new();
        for block in blocks {
            let units: Vec<TransmissionUnit> =
                block.motions.iter().map(|m| self.render_motion_unit(block, m)).collect::<Result<_, _>>()?;
            text.extend(units.iter().map(|unit| unit.text.as_str()));
            all.push(units);
        }
        text += &join_lines(self.render_foot(&program)?);
        Ok(TransmissionText { units_by_block: all, programs_to_read_back: vec![text], head_line_count: head_lines })
    }

    fn render_motion_unit(&self, block: &MotionBlock, motion: &Motion) -> Result<TransmissionUnit, RenderError> {
        let motions = vec![motion.clone()];
        let lines = self.render_block(&MotionBlock { motions: motions.clone(), ..*block })?;
        Ok(TransmissionUnit { motions, text: join_lines(lines), clamp_wait_s: self.clamp_wait_s(motion) })
    }

    /// Renders a program for each part of a block. The probe stays on from program to program.
    fn render_program_per_block_part(
        &self,
        axes: &[Axis],
        log: &str,
        blocks: &[MotionBlock],
    ) -> Result<TransmissionText, RenderError> {
        let dialect = self.without_probe_off_command();
        let mut all = Vec::new();
        for block in blocks {
            let parts = block.motions.split_inclusive(is_back_off);
            let units: Vec<TransmissionUnit> = parts
                .map(|motions| dialect.render_program_unit(axes, log, block, motions))
                .collect::<Result<_, _>>()?;
            all.push(units);
        }
        let programs = all.iter().flatten().map(|unit| unit.text.clone()).collect();
        Ok(TransmissionText { units_by_block: all, programs_to_read_back: programs, head_line_count: 0 })
    }

    fn render_program_unit(
        &self,
        axes: &[Axis],
        log: &str,
        block: &MotionBlock,
        motions: &[Motion],
    ) -> Result<TransmissionUnit, RenderError> {
        let title = format!("step {} repeat {}", block.step, block.repeat);
        let program = HeadAndFootValues { title: &title, axes, result_log_path: Some(log) };
        let motions = motions.to_vec();
        let part = MotionBlock { motions: motions.clone(), ..*block };
        let text = self.render_program(&program, std::slice::from_ref(&part))?;
        let clamp_wait_s = motions.iter().map(|motion| self.clamp_wait_s(motion)).sum();
        Ok(TransmissionUnit { motions, text, clamp_wait_s })
    }
}

fn join_lines(lines: Vec<String>) -> String {
    lines.into_iter().map(|line| line + "\n").collect()
}

fn is_back_off(motion: &Motion) -> bool {
    matches!(motion, Motion::BackOff { .. })
}
