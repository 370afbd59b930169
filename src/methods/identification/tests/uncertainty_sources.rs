//! Tests of sources, weights and priors.

use machine::record::estimate::Unit;
use nalgebra::Matrix2;

use super::{MeanModel, assert_near};
use crate::identification::{
    IdentificationOutputs, ObservationEffect, ObservationSpanChange, OutputParameter, ResidualTreatment,
    UncertaintySource, block_covariances, identify,
};

fn span(first: usize, values: &[f64]) -> ObservationSpanChange {
    ObservationSpanChange { first_index: first, changes_mm: values.to_vec() }
}

/// Hand calculation with two blocks of two observations and one more observation.
#[test]
fn block_covariances_agree_with_hand_calculation() {
    let sources = [
        UncertaintySource::new("each", ObservationEffect::Independent(vec![1.0, 2.0, 3.0, 4.0, 5.0])),
        UncertaintySource::new("run", ObservationEffect::Spans(vec![span(1, &[0.5, 0.25]), span(4, &[9.0])])),
        UncertaintySource::new("joint", ObservationEffect::Joint(vec![vec![1.0, -1.0], vec![0.0; 5]])),
        UncertaintySource {
            is_in_weights: false,
            ..UncertaintySource::new("apart", ObservationEffect::Joint(vec![vec![7.0; 5]]))
        },
    ];
    let expected = [Matrix2::new(2.0, -1.0, -1.0, 5.25), Matrix2::new(9.0625, 0.0, 0.0, 16.0)];
    assert_eq!(block_covariances::<2>(&sources, 2), expected);
    let single = block_covariances::<1>(&sources, 5);
    assert_eq!(single.iter().map(|s| s[0]).collect::<Vec<_>>(), [2.0, 5.25, 9.0625, 16.0, 106.0]);
}

#[test]
fn draws_expand_to_changes_of_all_observations() {
    let [each, spans, joint] = [
        ObservationEffect::Independent(vec![1.0, 2.0, 3.0]),
        ObservationEffect::Spans(vec![span(1, &[4.0, 5.0])]),
        ObservationEffect::Joint(vec![vec![6.0], vec![7.0, 8.0]]),
    ]
    .map(|effect| UncertaintySource::new("one", effect));
    assert_eq!([&each, &spans, &joint].map(UncertaintySource::draw_count), [3, 1, 2]);
    assert_eq!(each.observation_change(1, 3), [0.0, 2.0, 0.0]);
    assert_eq!(spans.observation_change(0, 3), [0.0, 4.0, 5.0]);
    assert_eq!(joint.observation_change(1, 3), [7.0, 8.0, 0.0]);
    assert!(!each.is_zero() && !spans.is_zero() && !joint.is_zero());
    let mut zero = UncertaintySource::new("zero", ObservationEffect::Joint(vec![vec![0.0; 3]; 2]));
    assert!(zero.is_zero());
    zero.direct_unknown_changes = vec![vec![0.0], vec![1.0]];
    assert!(!zero.is_zero());
}

/// Two parameters that an estimate publishes in µm and µrad enter with the same covariance that they had in
/// mm and rad.
#[test]
fn prior_has_the_covariance_of_its_estimate() {
    let mean = MeanModel::from_readings(&[1.0, 2.0]);
    let fit = mean.solved_linear_fit();
    let each = UncertaintySource {
        dof: 7.0,
        residual_treatment: ResidualTreatment::ExcludedFromChi2,
        ..UncertaintySource::new("each", ObservationEffect::Independent(vec![3e-3, 4e-3]))
    };
    let mut outputs = IdentificationOutputs::default();
    for (symbol, unit, slope) in [("EX0C", Unit::Um, 2.0), ("EA0C", Unit::Urad, -0.1)] {
        outputs.linear_parameters.push(OutputParameter::from_coefficients(symbol, unit, vec![slope], &[1.5]));
    }
    let identified = identify(&mean.solved_model_of_full_rank(&fit, true), &[each], outputs, None).unwrap();
    let prior = identified.estimate("mean");
    assert_near(prior.covariance.rows[0][1], -2.0 * 0.1 * 2.5e-3_f64.powi(2) * 1e9, 1e-9);

    let columns = [vec![1.0, 0.0, 0.0], vec![0.0, 1.0, 5.0]];
    let source = UncertaintySource::from_prior(&prior, &["EA0C", "EX0C"], &columns).unwrap();
    assert_eq!(
        (source.name.as_str(), source.residual_treatment),
        ("estimate of mean", ResidualTreatment::InExpectedChi2)
    );
    assert_near(source.dof, 7.0, 1e-9);
    let changes: Vec<Vec<f64>> = (0..2).map(|draw| source.observation_change(draw, 3)).collect();
    // EA0C acts on the first observation, EX0C on the second and five times on the third.
    let derivatives = [-0.1, 2.0, 10.0].map(|derivative| 2.5e-3 * derivative);
    for (i, di) in derivatives.iter().enumerate() {
        for (j, dj) in derivatives.iter().enumerate() {
            let covariance: f64 = changes.iter().map(|change| change[i] * change[j]).sum();
            assert_near(covariance, di * dj, 1e-12);
        }
    }
    assert!(UncertaintySource::from_prior(&prior, &["EY0C"], &columns[..1]).is_none());
}
