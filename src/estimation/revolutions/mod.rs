//! Harmonics of several channels over revolutions of an axis, with their scatter. The steps: samples to equal
//! angles by [`Resampler`] or from stops, selection of the revolutions that all channels share, harmonics.
//! Detects from the samples that a channel is saturated, has a separate clock, or a wrong gain or angle.

mod calibration;
mod clock_rate;
mod drift_correction;
mod harmonics;
mod resample;
mod resample_filter;
mod saturation;
mod shared_revolutions;
mod stop_scan;

#[cfg(test)]
mod tests;

pub use calibration::{DeclaredSensor, SensorCalibration, calibrate_sensors};
pub use clock_rate::estimate_clock_rate_error;
pub use harmonics::{HarmonicBasis, HarmonicData, RevolutionsError};
pub use resample::{AngleRange, AngleSample, ResampledChannel, Resampler};
pub use resample_filter::{KERNEL_HALF_WIDTH_OUTPUT_STEPS, ResampleFilter};
pub use saturation::invalidate_saturated_samples;
pub use shared_revolutions::{
    ChannelAtMounting, ChannelRevolutions, RejectedRevolutions, append_revolutions, common_and_rejected_revolutions,
    remove_channels_with_fewer_revolutions,
};
pub use stop_scan::StopScan;
