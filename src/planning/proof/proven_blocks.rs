//! Blocks whose text was proven: a driver executes nothing else.

use sha2::{Digest as _, Sha256};

use super::refusal::{ProofRefusal, RefusalReason};
use super::{ProofRequest, prove_read_motions};
use crate::gcode::rs274::ReadMotion;
use crate::gcode::{Dialect, ReadBackMismatch, RenderError, TransmissionForm, TransmissionText, TransmissionUnit};
use crate::motion_target;
use machine::record::motion::{Motion, MotionBlock};
use machine::record::stage_proof::StageProof;
use machine::{Axis, Position};

/// Error: a stage has no proven blocks. Nothing has moved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StageProofError {
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    Refused(#[from] ProofRefusal),
}

impl StageProofError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::Render(error) => error.remedy(),
            Self::Refused(refusal) => refusal.remedy().to_owned(),
        }
    }
}

/// Text of one block in the form in which it is sent, and the required start position of the machine. Only the proof
/// creates a proven block; a driver executes the block once and does not change it.
#[derive(Debug)]
pub struct ProvenBlock {
    step: u32,
    start_position: Position,
    transmission: TransmissionForm,
    units: Vec<ProvenUnit>,
    /// Digest of the other fields at the time of the proof.
    proof_digest: [u8; 32],
}

/// A unit, and the motions that the G-code reader found in its text.
#[derive(Debug, Clone, PartialEq)]
pub struct ProvenUnit {
    pub unit: TransmissionUnit,
    /// One motion for each of `unit.motions`.
    pub read_motions: Vec<ReadMotion>,
}

/// Error: a block was changed after its proof.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("step {step}: the block was changed after its proof")]
pub struct AlteredBlockError {
    pub step: u32,
}

impl ProvenBlock {
    fn new(step: u32, start_position: Position, transmission: TransmissionForm, units: Vec<ProvenUnit>) -> Self {
        let mut block = Self { step, start_position, transmission, units, proof_digest: [0; 32] };
        block.proof_digest = block.compute_digest();
        block
    }

    /// Digest of all other fields.
    fn compute_digest(&self) -> [u8; 32] {
        let Self { step, start_position, transmission, units, proof_digest: _ } = self;
        Sha256::digest(format!("{step}{start_position:?}{transmission:?}{units:?}")).into()
    }

    /// Form in which the control receives the block.
    pub fn transmission(&self) -> &TransmissionForm {
        &self.transmission
    }

    /// Id of the step in the plan.
    pub fn step(&self) -> u32 {
        self.step
    }

    /// Position of the machine at the start of the block, machine coordinates: the axes whose position the proof
    /// knows.
    pub fn start_position(&self) -> &Position {
        &self.start_position
    }

    /// Motions of all units as planned, in order.
    pub fn motions(&self) -> impl Iterator<Item = &Motion> {
        self.units.iter().flat_map(|part| &part.unit.motions)
    }

    /// Units to be sent.
    ///
    /// # Errors
    /// The units differ from those that were proven.
    pub fn units(&self) -> Result<&[ProvenUnit], AlteredBlockError> {
        let is_proven = self.compute_digest() == self.proof_digest;
        if is_proven { Ok(&self.units) } else { Err(AlteredBlockError { step: self.step }) }
    }
}

/// Renders the blocks of the stages as they are sent, proves that this text moves nothing into a body, and returns it.
/// `blocks`: the motions that the text must contain, in order.
///
/// # Errors
/// A block cannot be rendered; the first line that is wrong or cannot be proven.
pub fn prove_blocks(
    request: &ProofRequest<'_>,
    transmission: &TransmissionForm,
    blocks: &[MotionBlock],
) -> Result<(StageProof, Vec<ProvenBlock>), StageProofError> {
    let dialect = request.dialect;
    let axes: Vec<Axis> = request.plan.machine.axes.keys().copied().collect();
    let sent = dialect.render_for_transmission(transmission, &axes, blocks)?;
    let read = read_back_programs(dialect, &sent.programs_to_read_back)?;
    let proof = prove_read_motions(request, read.clone())?;
    let start_position = request.start_position.cloned().unwrap_or_default();
    Ok((proof, assign_motions_to_units(dialect, blocks, transmission, sent, read, start_position)?))
}

/// Reads one rendered block back.
///
/// # Errors
/// The first fault that the G-code reader finds.
pub(super) fn read_back_block(
    block: &MotionBlock,
    start_position: Position,
    dialect: &Dialect,
    transmission: &TransmissionForm,
    sent: TransmissionText,
) -> Result<ProvenBlock, StageProofError> {
    let blocks = std::slice::from_ref(block);
    let read = read_back_programs(dialect, &sent.programs_to_read_back)?;
    let mut proven = assign_motions_to_units(dialect, blocks, transmission, sent, read, start_position)?;
    proven.pop().ok_or(RefusalReason::ProgramEndsBeforeStep(block.step).at_line(1).into())
}

/// Assigns to each unit its motions of `read`, and compares them with the rendered motions.
fn assign_motions_to_units(
    dialect: &Dialect,
    blocks: &[MotionBlock],
    transmission: &TransmissionForm,
    sent: TransmissionText,
    read_motions: Vec<ReadMotion>,
    mut start_position: Position,
) -> Result<Vec<ProvenBlock>, ProofRefusal> {
    check_line_lengths(transmission, &sent)?;
    let mut remaining = read_motions.into_iter().peekable();
    let mut proven = Vec::new();
    let mut last_line = sent.head_line_count;
    for (block, units) in blocks.iter().zip(sent.units_by_block) {
        let mut parts = Vec::new();
        for unit in units {
            last_line += unit.text.lines().count();
            let own = std::iter::from_fn(|| remaining.next_if(|motion| motion.line <= last_line));
            let read_motions: Vec<ReadMotion> = own.collect();
            dialect.check_read_motions(block.step, &unit.motions, &read_motions).map_err(mismatch_refusal)?;
            parts.push(ProvenUnit { unit, read_motions });
        }
        proven.push(ProvenBlock::new(block.step, start_position.clone(), transmission.clone(), parts));
        start_position = block.motions.iter().fold(start_position, known_position_after_motion);
    }
    match remaining.next() {
        None => Ok(proven),
        Some(motion) => Err(RefusalReason::UnassignedMotion.at_line(motion.line)),
    }
}

/// Motions of programs that are sent one after the other, each read from an unknown state. The line numbers
/// continue from program to program.
pub(super) fn read_back_programs(dialect: &Dialect, programs: &[String]) -> Result<Vec<ReadMotion>, ProofRefusal> {
    let (mut all, mut before) = (Vec::new(), 0);
    for program in programs {
        let read = dialect
            .read_back(program)
            .map_err(|error| RefusalReason::UnreadableLine(error.reason).at_line(before + error.line))?;
        all.extend(read.into_iter().map(|motion| ReadMotion { line: before + motion.line, ..motion }));
        before += program.lines().count();
    }
    Ok(all)
}

/// Checks the lines of the units, but not those of head and foot; only for [`TransmissionForm::Lines`].
fn check_line_lengths(transmission: &TransmissionForm, sent: &TransmissionText) -> Result<(), ProofRefusal> {
    let TransmissionForm::Lines { max_line_bytes } = *transmission else { return Ok(()) };
    let mut lines = sent.units_by_block.iter().flatten().flat_map(|unit| unit.text.lines());
    match lines.find(|line| line.len() >= max_line_bytes) {
        Some(line) => Err(RefusalReason::LineTooLong(line.to_owned()).at_line(1)),
        None => Ok(()),
    }
}

/// Position of the machine after a motion; after a touch, the position of its axes is unknown.
fn known_position_after_motion(position: Position, motion: &Motion) -> Position {
    match motion {
        Motion::Probe { to, .. } => position.filter_axes(|axis| to.get(axis).is_none()),
        motion => motion_target(motion).map_or(position.clone(), |to| position.updated_by(&to)),
    }
}

fn mismatch_refusal(disagreement: ReadBackMismatch) -> ProofRefusal {
    let line = match &disagreement {
        ReadBackMismatch::MotionDiffers { line, .. } => *line,
        _ => 1,
    };
    RefusalReason::TextMismatch(disagreement.to_string()).at_line(line)
}

#[cfg(test)]
mod tests {
    use super::super::for_tests::{prove_block_text, prove_block_text_from};
    use super::super::tests::{cylinder_touch_plan, position_beside_part};
    use super::*;

    fn proven_x_move() -> Vec<ProvenBlock> {
        let to = Position::new().with(Axis::X, 90.0);
        let motions = vec![Motion::Guarded { to, feed_mm_min: 100.0 }];
        let block = MotionBlock { step: 0, repeat: 0, motions };
        let axes: Vec<Axis> = cylinder_touch_plan(|_| {}).machine.axes.keys().copied().collect();
        let dialect = Dialect::from_name("grbl").unwrap();
        let transmission = TransmissionForm::Lines { max_line_bytes: 80 };
        vec![prove_block_text_from(position_beside_part(), &block, &axes, &dialect, &transmission).unwrap()]
    }

    #[test]
    fn a_unit_that_was_changed_after_the_proof_is_refused() {
        for change in 0..4 {
            let mut block = proven_x_move().remove(0);
            assert_eq!(block.units().unwrap().len(), 1);
            match change {
                0 => block.units[0].unit.text = block.units[0].unit.text.replace("X90", "X91"),
                1 => block.units[0].read_motions[0].target = Position::new().with(Axis::X, 91.0),
                2 => block.start_position = Position::new(),
                _ => block.transmission = TransmissionForm::TableRows,
            }
            assert_eq!(block.units(), Err(AlteredBlockError { step: 0 }));
        }
    }

    #[test]
    fn motions_in_the_wrong_unit_have_no_proof() {
        let dialect = Dialect::from_name("grbl").unwrap();
        let to = |x: f64| Position::new().with(Axis::X, x);
        let motions = [90.0, 95.0].map(|x| Motion::Guarded { to: to(x), feed_mm_min: 100.0 });
        let blocks = [MotionBlock { step: 0, repeat: 0, motions: motions.to_vec() }];
        let lines = TransmissionForm::Lines { max_line_bytes: 80 };
        let sent = dialect.render_for_transmission(&lines, &[Axis::X], &blocks).unwrap();
        let proven = |sent: TransmissionText| {
            let read = read_back_programs(&dialect, &sent.programs_to_read_back)?;
            assign_motions_to_units(&dialect, &blocks, &lines, sent, read, position_beside_part())
        };
        assert!(proven(sent.clone()).is_ok());
        let mut moved = sent;
        let [first, second] = moved.units_by_block[0].as_mut_slice() else { panic!("two units") };
        second.text = std::mem::take(&mut first.text) + &second.text;
        assert!(proven(moved).is_err());
    }

    #[test]
    fn a_block_that_differs_from_its_text_has_no_proof() {
        // The block can be rendered, but a control reads no feed in it.
        let to = Position::new().with(Axis::Z, -20.0);
        let motions = vec![Motion::Guarded { to, feed_mm_min: -300.0 }];
        let block = MotionBlock { step: 3, repeat: 0, motions };
        let (dialect, lines) = (Dialect::from_name("grbl").unwrap(), TransmissionForm::Lines { max_line_bytes: 80 });
        let refused = prove_block_text(&block, &[Axis::Z], &dialect, &lines);
        assert!(matches!(refused, Err(StageProofError::Refused(_))), "{refused:?}");
    }
}
