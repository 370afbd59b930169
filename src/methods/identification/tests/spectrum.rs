//! Amplitudes, compared with hand calculation.

use faer::Mat;
use machine::record::estimate::{FunctionFigureKind, Unit};

use super::{assert_near, solved_model_of_full_rank};
use crate::identification::{
    Harmonic, HarmonicFunction, IdentificationOutputs, ObservationEffect, SolvedLinearFit, UncertaintySource, identify,
    slope_of_unknown,
};

/// Two unknowns that are observed directly: 3 µm and 4 µm, with u of 1 µm and 2 µm.
#[test]
fn amplitudes_and_their_u_agree_with_hand_calculation() {
    let x = [3e-3, 4e-3];
    let one = Mat::identity(2, 2);
    let fit = SolvedLinearFit { x: &x, design_matrix: &one, sigma: &[1.0; 2], gain: &one };
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![1e-3, 2e-3]))];
    let solution = solved_model_of_full_rank(&fit, &[0.0; 2], true);
    let identified = identify(&solution, &sources, IdentificationOutputs::default(), None).unwrap();
    let [first, second] = [0, 1].map(|index| slope_of_unknown(index, 2));
    let harmonic =
        |order, cos: &[f64], sin: &[f64]| Harmonic { order, cosine_and_sine_slopes: [cos.to_vec(), sin.to_vec()] };
    let spectrum = HarmonicFunction {
        symbol: "EXC".to_owned(),
        unit: Unit::Um,
        harmonics: vec![
            // Cosine and sine part are independent: amplitude 5 µm; the u of the amplitude is at most that of
            // the sine part.
            harmonic(2.0, &first, &second),
            // Cosine and sine part are equal: u is 1 µm along both, √2 µm along 45°.
            harmonic(5.0, &first, &first),
            harmonic(0.5, &[0.0; 2], &first),
        ],
    };
    let function = identified.spectrum(&spectrum, &x);
    assert_eq!((function.figure, function.x), (FunctionFigureKind::Spectrum, vec![0.5, 2.0, 5.0]));
    let known = [(3.0, 1.0), (5.0, 2.0), (18f64.sqrt(), 2f64.sqrt())];
    for ((y, u), (amplitude, expected)) in function.y.iter().zip(&function.u).zip(known) {
        assert_near(*y, amplitude, 1e-9);
        assert_near(*u, expected, 1e-9);
    }
    // An amplitude of zero: the phase is unknown, and u is that of one part.
    let zero = identified.spectrum(&spectrum, &[0.0; 2]);
    assert_near(zero.y[1], 0.0, 1e-9);
    assert_near(zero.u[1], 2.0, 1e-9);
}
