//! Harmonics of several channels over revolutions of an axis, with their scatter. The steps: samples to equal
//! angles by [`Resampler`] or from stops, selection of the revolutions that all channels share, harmonics.
//! Detection of channel faults from the samples: saturation, a separate clock, gain and angle.

mod calibration;
mod clock;
mod common;
mod drift;
mod filter;
mod harmonics;
mod resample;
mod saturation;
mod stops;

#[cfg(test)]
mod tests;

pub use calibration::{DeclaredSensor, SensorCalibration, calibrate_sensors};
pub use clock::clock_error;
pub use common::{
    RejectedRevolutions, Row, RowRevolutions, append_revolutions, common_revolutions,
    split_incomplete,
};
pub use filter::{KERNEL_HALF_STEPS, ResampleFilter};
pub use harmonics::{HarmonicBasis, HarmonicData, RevolutionsError};
pub use resample::{AngleRange, Resampled, Resampler, Sample};
pub use saturation::reject_saturated;
pub use stops::Stops;
