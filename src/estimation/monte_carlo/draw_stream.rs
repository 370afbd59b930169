//! Normal and rectangular deviates in batches: eight lanes of xoshiro256++ (Blackman & Vigna 2019) and the
//! transform of Box & Muller (1958), without branches so that the compiler vectorises the loops. Only +, −, ×, ÷, √
//! and integer operations are used. All of them are exactly rounded, so the numbers are the same on every computer.

use std::f64::consts::{LN_2, PI};

use pulp::{Arch, Simd, WithSimd};
use rand::Rng;

use super::DrawDistribution;
use crate::random::seeded_stream;

/// Number of generators that run side by side.
const LANE_COUNT: usize = 8;
/// Number of pairs of deviates per batch.
const DEVIATE_PAIRS_PER_BATCH: usize = 256;
/// Half a step of the angle, in half turns: with this offset the angles are symmetric about zero.
const ANGLE_OFFSET_HALF_TURNS: f64 = 1.0 / 16_777_216.0;
/// Bit pattern of 1.0 as `f64`.
const ONE_BITS: u64 = 0x3FF0_0000_0000_0000;

/// A stream of independent draws of mean 0 and variance 1.
#[derive(Debug, Clone)]
pub struct DrawStream {
    lanes: Xoshiro,
    simd: Arch,
}

impl DrawStream {
    /// Creates the stream. The state of all lanes is drawn from the [`seeded_stream`] of `seed` for `key`.
    pub fn from_key(seed: u64, key: &[u64]) -> Self {
        let mut seeder = seeded_stream(seed, key);
        let state = std::array::from_fn(|_| std::array::from_fn(|_| seeder.next_u64()));
        Self { lanes: Xoshiro(state), simd: Arch::new() }
    }

    /// Draws of mean 0 and variance 1, trials × draws, column after column. Draw `j` has the distribution
    /// `distributions[j]`.
    pub fn unit_variance_draws(&mut self, trials: usize, distributions: &[DrawDistribution]) -> Vec<f64> {
        let mut units = vec![0.0; trials * distributions.len()];
        let mut rest = units.as_mut_slice();
        for alike in distributions.chunk_by(|a, b| a == b) {
            let (own, after) = rest.split_at_mut(trials * alike.len());
            match alike[0] {
                DrawDistribution::Normal => self.fill_normal(own),
                DrawDistribution::Rectangular => self.fill_rectangular(own),
            }
            rest = after;
        }
        units
    }

    fn fill_rectangular(&mut self, out: &mut [f64]) {
        let Self { lanes, simd: arch } = self;
        for values in out.chunks_mut(DEVIATE_PAIRS_PER_BATCH) {
            arch.dispatch(FillRectangular { lanes, values });
        }
    }

    fn fill_normal(&mut self, out: &mut [f64]) {
        let Self { lanes, simd: arch } = self;
        let mut pairs = out.chunks_exact_mut(2 * DEVIATE_PAIRS_PER_BATCH);
        for pair in &mut pairs {
            let (first, second) = pair.split_at_mut(DEVIATE_PAIRS_PER_BATCH);
            arch.dispatch(FillNormalPairs { lanes, first, second });
        }
        let rest = pairs.into_remainder();
        if !rest.is_empty() {
            let (mut first, mut second) = ([0.0; DEVIATE_PAIRS_PER_BATCH], [0.0; DEVIATE_PAIRS_PER_BATCH]);
            arch.dispatch(FillNormalPairs { lanes, first: &mut first, second: &mut second });
            for (value, normal) in rest.iter_mut().zip(first.iter().chain(&second)) {
                *value = *normal;
            }
        }
    }
}

/// Fills at most [`DEVIATE_PAIRS_PER_BATCH`] rectangular deviates.
struct FillRectangular<'a> {
    lanes: &'a mut Xoshiro,
    values: &'a mut [f64],
}

impl WithSimd for FillRectangular<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // Scales the interval [−½, ½) to unit variance: √12.
        const UNIT_VARIANCE_WIDTH: f64 = 3.464_101_615_137_754_4;
        let mut bits = [0; DEVIATE_PAIRS_PER_BATCH];
        self.lanes.fill(&mut bits);
        for (value, bits) in self.values.iter_mut().zip(&bits) {
            *value = UNIT_VARIANCE_WIDTH * (f64::from_bits((bits >> 12) | ONE_BITS) - 1.5);
        }
    }
}

/// Fills [`DEVIATE_PAIRS_PER_BATCH`] pairs of normal deviates. A struct instead of a closure, because a closure is not
/// inlined with the wide registers enabled.
struct FillNormalPairs<'a> {
    lanes: &'a mut Xoshiro,
    first: &'a mut [f64],
    second: &'a mut [f64],
}

impl WithSimd for FillNormalPairs<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let mut bits = [0; DEVIATE_PAIRS_PER_BATCH];
        self.lanes.fill(&mut bits);
        for ((first, second), bits) in self.first.iter_mut().zip(self.second).zip(&bits) {
            (*first, *second) = normal_pair(*bits);
        }
    }
}

/// Two independent normal deviates from 64 random bits: 40 bits for the radius (at most 7.4), 23 for the angle, one
/// for the half turn.
#[inline(always)]
fn normal_pair(bits: u64) -> (f64, f64) {
    // 2 − [1, 2) lies in (0, 1]: the logarithm is finite.
    let radius = (-2.0 * ln(2.0 - f64::from_bits((bits >> 24 << 12) | ONE_BITS))).sqrt();
    let angle = PI * (f64::from_bits((bits << 41 >> 12) | ONE_BITS) - (1.5 - ANGLE_OFFSET_HALF_TURNS));
    let signed = f64::from_bits(radius.to_bits() | ((bits << 40) & (1 << 63)));
    (signed * cos(angle), signed * sin(angle))
}

/// ln(x) for normal x > 0: exponent plus mantissa in [√½, √2), the latter by the series of artanh, exact to 2e-11
/// absolute.
#[inline(always)]
fn ln(x: f64) -> f64 {
    const SQRT_HALF_BITS: u64 = 0x3FE6_A09E_667F_3BCD;
    let bits = x.to_bits() + (ONE_BITS - SQRT_HALF_BITS);
    // The biased exponent as a number, computed through the mantissa of 2⁵².
    let exponent = f64::from_bits((bits >> 52) | 0x4330_0000_0000_0000) - (4_503_599_627_370_496.0 + 1023.0);
    let mantissa = f64::from_bits((bits & 0x000F_FFFF_FFFF_FFFF) + SQRT_HALF_BITS);
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let q = s * s;
    let series = polynomial(q, [1.0 / 11.0, 1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0, 1.0]);
    exponent * LN_2 + 2.0 * s * series
}

/// sin on [−π/2, π/2], Taylor series to x¹⁵, error 7e-12 absolute.
#[inline(always)]
fn sin(x: f64) -> f64 {
    let q = x * x;
    x * polynomial(
        q,
        [
            -1.0 / 1_307_674_368_000.0,
            1.0 / 6_227_020_800.0,
            -1.0 / 39_916_800.0,
            1.0 / 362_880.0,
            -1.0 / 5_040.0,
            1.0 / 120.0,
            -1.0 / 6.0,
            1.0,
        ],
    )
}

/// cos on [−π/2, π/2], Taylor series to x¹⁴, error 7e-11 absolute.
#[inline(always)]
fn cos(x: f64) -> f64 {
    polynomial(
        x * x,
        [
            -1.0 / 87_178_291_200.0,
            1.0 / 479_001_600.0,
            -1.0 / 3_628_800.0,
            1.0 / 40_320.0,
            -1.0 / 720.0,
            1.0 / 24.0,
            -1.0 / 2.0,
            1.0,
        ],
    )
}

/// Horner's rule, highest coefficient first.
#[inline(always)]
fn polynomial<const N: usize>(x: f64, coefficients: [f64; N]) -> f64 {
    coefficients.iter().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

/// Eight independent generators side by side: `state[word][lane]`.
#[derive(Debug, Clone)]
struct Xoshiro([[u64; LANE_COUNT]; 4]);

impl Xoshiro {
    /// Fills `out`: lane l gives elements l, l + 8, …. The length of `out` is a multiple of eight.
    #[inline(always)]
    fn fill(&mut self, out: &mut [u64]) {
        let [mut s0, mut s1, mut s2, mut s3] = self.0;
        for out in out.chunks_exact_mut(LANE_COUNT) {
            for l in 0..LANE_COUNT {
                out[l] = s0[l].wrapping_add(s3[l]).rotate_left(23).wrapping_add(s0[l]);
                let t = s1[l] << 17;
                s2[l] ^= s0[l];
                s3[l] ^= s1[l];
                s1[l] ^= s2[l];
                s0[l] ^= s3[l];
                s2[l] ^= t;
                s3[l] = s3[l].rotate_left(45);
            }
        }
        self.0 = [s0, s1, s2, s3];
    }
}

#[cfg(test)]
mod tests {
    use statrs::distribution::{ContinuousCDF, Normal, Uniform};

    use super::*;

    /// The published reference implementation, started from the state (1, 2, 3, 4).
    #[test]
    fn paper_xoshiro256_plus_plus_reference() {
        let mut lanes = Xoshiro(std::array::from_fn(|word| [word as u64 + 1; LANE_COUNT]));
        let mut out = [0; 8 * LANE_COUNT];
        lanes.fill(&mut out);
        let expected = [
            41_943_041,
            58_720_359,
            3_588_806_011_781_223,
            3_591_011_842_654_386,
            9_228_616_714_210_784_205,
            9_973_669_472_204_895_162,
            14_011_001_112_246_962_877,
        ];
        for (row, expected) in out.chunks(LANE_COUNT).zip(expected) {
            assert_eq!(row, [expected; LANE_COUNT]);
        }
    }

    #[test]
    fn ln_sin_and_cos_agree_with_the_standard_library() {
        for i in 0..=20_000 {
            let x = PI * (f64::from(i) / 20_000.0 - 0.5);
            assert!((sin(x) - x.sin()).abs() < 1e-11 && (cos(x) - x.cos()).abs() < 1e-10, "{x}");
            let u = (f64::from(i) + 1.0) / 20_001.0;
            assert!((ln(u) - u.ln()).abs() < 2e-11, "{u}");
        }
        for u in [f64::EPSILON, 1e-9, 0.7, 0.71, 1.0] {
            assert!((ln(u) - u.ln()).abs() < 2e-11, "{u}");
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn deviates_are_normal_and_independent() {
        const COUNT: usize = 400_000;
        let mut values = vec![0.0; COUNT + 3];
        DrawStream::from_key(7, &[1]).fill_normal(&mut values);
        let root = (COUNT as f64).sqrt();
        let average = |f: &dyn Fn(usize) -> f64| (0..COUNT).map(f).sum::<f64>() / COUNT as f64;
        // Moments 1 to 4 are within four of their standard deviations 1, √2, √15, √96.
        for (power, expected, deviation) in
            [(1, 0.0, 1.0), (2, 1.0, 2_f64.sqrt()), (3, 0.0, 15_f64.sqrt()), (4, 3.0, 96_f64.sqrt())]
        {
            let moment = average(&|i| values[i].powi(power));
            assert!((moment - expected).abs() < 4.0 * deviation / root, "{power}: {moment}");
        }
        // Correlation of neighbours, of lanes, and of the two members of a pair, of the values and of their
        // squares.
        for lag in [1, LANE_COUNT, DEVIATE_PAIRS_PER_BATCH, 2 * DEVIATE_PAIRS_PER_BATCH] {
            let plain = average(&|i| values[i] * values[(i + lag) % COUNT]);
            let squared = average(&|i| (values[i].powi(2) - 1.0) * (values[(i + lag) % COUNT].powi(2) - 1.0));
            assert!(plain.abs() < 4.0 / root && squared.abs() < 8.0 / root, "{lag}: {plain} {squared}");
        }
        values.truncate(COUNT);
        assert_distributed_as(values, &Normal::standard());
    }

    #[test]
    fn rectangular_deviates_are_rectangular_and_independent() {
        const COUNT: usize = 400_000;
        let mut values = DrawStream::from_key(7, &[2]).unit_variance_draws(COUNT + 3, &[DrawDistribution::Rectangular]);
        let root = (COUNT as f64).sqrt();
        for lag in [1, LANE_COUNT, DEVIATE_PAIRS_PER_BATCH] {
            let products = (0..COUNT).map(|i| values[i] * values[(i + lag) % COUNT]);
            let mean = products.sum::<f64>() / COUNT as f64;
            assert!(mean.abs() < 4.0 / root, "{lag}: {mean}");
        }
        values.truncate(COUNT);
        assert_distributed_as(values, &Uniform::new(-(3f64.sqrt()), 3f64.sqrt()).unwrap());
    }

    /// Asserts that `values` have the distribution `expected` (Kolmogorov–Smirnov: the 0.1 % point of √n·D is 1.95).
    fn assert_distributed_as(mut values: Vec<f64>, expected: &impl ContinuousCDF<f64, f64>) {
        let count = values.len() as f64;
        values.sort_by(f64::total_cmp);
        let distance = values
            .iter()
            .enumerate()
            .fold(0.0, |worst: f64, (i, value)| worst.max((expected.cdf(*value) - i as f64 / count).abs()));
        assert!(distance * count.sqrt() < 1.95, "{}", distance * count.sqrt());
    }
}
