//! Reads rendered text back and compares it with the intended motions.

use std::f64::consts::TAU;

use super::dialect::Dialect;
use super::error::Disagreement;
use super::rs274::{self, Frame, Kind, ReadError, ReadMotion};
use machine::Axis;
use machine::record::motion::{Block, Motion};

/// Half a unit of the third decimal, plus rounding; feeds, seconds and orientations have three decimals.
const THIRD_DECIMAL: f64 = 0.000_501;

impl Dialect {
    /// Motions of `text`, which this dialect has rendered, as its control will understand them.
    ///
    /// # Errors
    /// The first line that is not understood.
    pub fn read_back(&self, text: &str) -> Result<Vec<ReadMotion>, ReadError> {
        rs274::read_with(text, Some(&self.spec.work_offset), &self.options.declared)
    }

    /// Maximum difference between a position and the intended one, mm or rad: half a unit of the last decimal, and
    /// a small allowance for the decimal fraction itself.
    pub fn rounding(&self, axis: Axis) -> f64 {
        let decimals = match axis {
            Axis::S => return axis.from_edge(THIRD_DECIMAL),
            axis if axis.is_linear() => self.spec.decimals_mm,
            _ => self.spec.decimals_deg,
        };
        axis.from_edge(0.501 * 0.1_f64.powi(decimals as i32))
    }

    /// Checks that `text`, a whole program, means exactly the motions of `blocks`. Targets agree to half a unit of
    /// the last decimal, all in machine coordinates.
    ///
    /// # Errors
    /// The first line that cannot be read or has another meaning.
    pub fn proves(&self, text: &str, blocks: &[Block]) -> Result<(), Disagreement> {
        let read = self.read_back(text)?;
        let meant = blocks.iter().map(|block| block.motions.len()).sum();
        if meant != read.len() {
            return Err(Disagreement::Count { meant, read: read.len() });
        }
        let mut read = read.as_slice();
        for block in blocks {
            let (of_block, rest) = read.split_at(block.motions.len());
            self.says(block.step, &block.motions, of_block)?;
            read = rest;
        }
        Ok(())
    }

    /// Checks that the read motions mean exactly the motions of one step.
    ///
    /// # Errors
    /// The first motion that has another meaning.
    pub(crate) fn says(
        &self,
        step: u32,
        meant: &[Motion],
        read: &[ReadMotion],
    ) -> Result<(), Disagreement> {
        if meant.len() != read.len() {
            return Err(Disagreement::Count { meant: meant.len(), read: read.len() });
        }
        meant.iter().zip(read).try_for_each(|(motion, read)| {
            let differs = |why| Disagreement::Motion { step, line: read.line, why };
            self.same(step, motion, read).map_err(differs)
        })
    }

    fn same(&self, step: u32, motion: &Motion, read: &ReadMotion) -> Result<(), String> {
        if read.n != Some(step) {
            return Err(format!("its N word is {:?}", read.n));
        }
        if read.frame != Frame::Machine {
            return Err(format!("it moves in the frame {:?}", read.frame));
        }
        let (to, feed) = match (motion, read.kind) {
            (Motion::Rapid { to }, Kind::Rapid) => (to, None),
            (
                Motion::BackOff { to, feed_mm_min } | Motion::Feed { to, feed_mm_min },
                Kind::Feed,
            )
            | (Motion::Guarded { to, feed_mm_min }, Kind::Probe { must_touch: false })
            | (Motion::Probe { to, feed_mm_min }, Kind::Probe { .. }) => (to, Some(*feed_mm_min)),
            (Motion::Dwell { seconds }, Kind::Dwell { seconds: read }) => {
                return near("dwell", *seconds, read, THIRD_DECIMAL);
            }
            (Motion::Orient { s }, Kind::Orient { s: read }) => {
                let turn = (s - read + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
                return near("orientation", 0.0, Axis::S.to_edge(turn), THIRD_DECIMAL);
            }
            (_, kind) => return Err(format!("it is a {kind:?}")),
        };
        if to.iter().count() != read.target.iter().count() {
            return Err("it moves other axes".to_owned());
        }
        for (axis, value) in to.iter() {
            let other = read.target.get(axis).ok_or_else(|| format!("{axis} does not move"))?;
            let half_unit = axis.to_edge(self.rounding(axis));
            near(&axis.to_string(), axis.to_edge(value), axis.to_edge(other), half_unit)?;
        }
        match (feed, read.feed_mm_min) {
            (Some(feed), Some(read)) => near("feed", feed, read, THIRD_DECIMAL),
            (None, None) => Ok(()),
            _ => Err("a feed is missing or too many".to_owned()),
        }
    }
}

/// Written so that a NaN on either side is refused.
fn near(what: &str, meant: f64, read: f64, tolerance: f64) -> Result<(), String> {
    if (meant - read).abs() <= tolerance {
        return Ok(());
    }
    Err(format!("{what} is {read} instead of {meant}"))
}
