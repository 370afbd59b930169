//! Harmonics of several channels over revolutions of an axis, with their scatter. The steps: samples to equal
//! angles by [`Resampler`] or from stops, selection of the revolutions that all channels share, harmonics.
//! Detection of channel faults from the samples: saturation, a separate clock, gain and angle.

mod calibration;
mod clock;
mod drift;
mod filter;
mod harmonics;
mod resample;
mod saturation;
mod shared_revolutions;
mod stops;

#[cfg(test)]
mod tests;

pub use calibration::{DeclaredSensor, SensorCalibration, calibrate_sensors};
pub use clock::estimate_clock_error;
pub use filter::{KERNEL_HALF_STEPS, ResampleFilter};
pub use harmonics::{HarmonicBasis, HarmonicData, RevolutionsError};
pub use resample::{AngleRange, AngleSample, Resampled, Resampler};
pub use saturation::reject_saturated;
pub use shared_revolutions::{
    ChannelAtIndex, ChannelRevolutions, RejectedRevolutions, append_revolutions, common_revolutions,
    remove_incomplete_rows,
};
pub use stops::StopScan;
