//! The models as stated in NIST's files, with derivatives computed by hand.

use std::f64::consts::{PI, TAU};

/// Value and gradient at the parameters `b` and the predictors `x`.
pub type Model = fn(b: &[f64], x: &[f64]) -> (f64, Vec<f64>);

pub const DATASET_MODELS: [(&str, Model); 27] = [
    ("Misra1a", exponential_saturation),
    ("Chwirut2", chwirut),
    ("Chwirut1", chwirut),
    ("Lanczos3", three_exponentials),
    ("Gauss1", exponential_plus_two_gaussians),
    ("Gauss2", exponential_plus_two_gaussians),
    ("DanWood", dan_wood),
    ("Misra1b", misra1b),
    ("Kirby2", kirby2),
    ("Hahn1", cubic_over_cubic),
    ("Nelson", nelson),
    ("MGH17", mgh17),
    ("Lanczos1", three_exponentials),
    ("Lanczos2", three_exponentials),
    ("Gauss3", exponential_plus_two_gaussians),
    ("Misra1c", misra1c),
    ("Misra1d", misra1d),
    ("Roszman1", roszman1),
    ("ENSO", enso),
    ("MGH09", mgh09),
    ("Thurber", cubic_over_cubic),
    ("BoxBOD", exponential_saturation),
    ("Rat42", rat42),
    ("MGH10", mgh10),
    ("Eckerle4", eckerle4),
    ("Rat43", rat43),
    ("Bennett5", bennett5),
];

/// b1·(1 − exp(−b2·x))
fn exponential_saturation(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let e = (-b[1] * x[0]).exp();
    (b[0] * (1.0 - e), vec![1.0 - e, b[0] * x[0] * e])
}

/// exp(−b1·x)/(b2 + b3·x)
fn chwirut(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let below = b[1] + b[2] * x[0];
    let y = (-b[0] * x[0]).exp() / below;
    (y, vec![-x[0] * y, -y / below, -x[0] * y / below])
}

/// Σ of three b·exp(−b′·x)
fn three_exponentials(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let terms = [0, 2, 4].map(|k| (b[k], (-b[k + 1] * x[0]).exp()));
    let gradient = terms.iter().flat_map(|(factor, e)| [*e, -factor * x[0] * e]).collect();
    (terms.iter().map(|(factor, e)| factor * e).sum(), gradient)
}

/// b1·exp(−b2·x) + b3·exp(−(x − b4)²/b5²) + b6·exp(−(x − b7)²/b8²)
fn exponential_plus_two_gaussians(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let decay = (-b[1] * x[0]).exp();
    let mut y = b[0] * decay;
    let mut gradient = vec![decay, -b[0] * x[0] * decay];
    for k in [2, 5] {
        let t = (x[0] - b[k + 1]) / b[k + 2];
        let e = (-t * t).exp();
        y += b[k] * e;
        gradient.extend([e, 2.0 * b[k] * e * t / b[k + 2], 2.0 * b[k] * e * t * t / b[k + 2]]);
    }
    (y, gradient)
}

/// b1·x^b2
fn dan_wood(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let power = x[0].powf(b[1]);
    (b[0] * power, vec![power, b[0] * power * x[0].ln()])
}

/// b1·(1 − (1 + b2·x/2)⁻²)
fn misra1b(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let t = 1.0 + 0.5 * b[1] * x[0];
    let shape = 1.0 - t.powi(-2);
    (b[0] * shape, vec![shape, b[0] * x[0] * t.powi(-3)])
}

/// b1·(1 − (1 + 2·b2·x)^−½)
fn misra1c(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let t = 1.0 + 2.0 * b[1] * x[0];
    let shape = 1.0 - t.powf(-0.5);
    (b[0] * shape, vec![shape, b[0] * x[0] * t.powf(-1.5)])
}

/// b1·b2·x/(1 + b2·x)
fn misra1d(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let t = 1.0 + b[1] * x[0];
    (b[0] * b[1] * x[0] / t, vec![b[1] * x[0] / t, b[0] * x[0] / (t * t)])
}

/// (b1 + b2·x + b3·x²)/(1 + b4·x + b5·x²)
fn kirby2(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    rational(&b[..3], &b[3..], x[0])
}

/// (b1 + b2·x + b3·x² + b4·x³)/(1 + b5·x + b6·x² + b7·x³)
fn cubic_over_cubic(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    rational(&b[..4], &b[4..], x[0])
}

/// (a1 + a2·x + …)/(1 + b1·x + b2·x² + …), with the gradient by all coefficients.
fn rational(numerator_coefficients: &[f64], denominator_coefficients: &[f64], x: f64) -> (f64, Vec<f64>) {
    let polynomial = |factors: &[f64]| factors.iter().rev().fold(0.0, |sum, b| sum * x + b);
    let denominator = 1.0 + x * polynomial(denominator_coefficients);
    let y = polynomial(numerator_coefficients) / denominator;
    let power = |k: usize| x.powi(k as i32) / denominator;
    let upper = (0..numerator_coefficients.len()).map(power);
    (y, upper.chain((1..=denominator_coefficients.len()).map(|k| -y * power(k))).collect())
}

/// ln y = b1 − b2·x1·exp(−b3·x2)
fn nelson(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let e = x[0] * (-b[2] * x[1]).exp();
    (b[0] - b[1] * e, vec![1.0, -e, b[1] * x[1] * e])
}

/// b1 + b2·exp(−x·b4) + b3·exp(−x·b5)
fn mgh17(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let [e, f] = [b[3], b[4]].map(|rate| (-x[0] * rate).exp());
    let y = b[0] + b[1] * e + b[2] * f;
    (y, vec![1.0, e, f, -x[0] * b[1] * e, -x[0] * b[2] * f])
}

/// b1 − b2·x − arctan(b3/(x − b4))/π
fn roszman1(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let d = x[0] - b[3];
    let inverse = 1.0 / (PI * (d * d + b[2] * b[2]));
    let y = b[0] - b[1] * x[0] - (b[2] / d).atan() / PI;
    (y, vec![1.0, -x[0], -d * inverse, -b[2] * inverse])
}

/// b1 plus a wave of period 12 and two waves of the periods b4 and b7
fn enso(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let wave = |period: f64| (TAU * x[0] / period).sin_cos();
    let (sine, cosine) = wave(12.0);
    let mut y = b[0] + b[1] * cosine + b[2] * sine;
    let mut gradient = vec![1.0, cosine, sine];
    for k in [3, 6] {
        let (period, c, s) = (b[k], b[k + 1], b[k + 2]);
        let (sine, cosine) = wave(period);
        y += c * cosine + s * sine;
        let turn = TAU * x[0] / (period * period);
        gradient.extend([turn * (c * sine - s * cosine), cosine, sine]);
    }
    (y, gradient)
}

/// b1·(x² + x·b2)/(x² + x·b3 + b4)
fn mgh09(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let x = x[0];
    let (above, below) = (x * x + x * b[1], x * x + x * b[2] + b[3]);
    let y = b[0] * above / below;
    (y, vec![above / below, b[0] * x / below, -y * x / below, -y / below])
}

/// b1/(1 + exp(b2 − b3·x))
fn rat42(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let e = (b[1] - b[2] * x[0]).exp();
    let t = 1.0 + e;
    let slope = b[0] * e / (t * t);
    (b[0] / t, vec![1.0 / t, -slope, slope * x[0]])
}

/// b1·exp(b2/(x + b3))
fn mgh10(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let d = x[0] + b[2];
    let e = (b[1] / d).exp();
    (b[0] * e, vec![e, b[0] * e / d, -b[0] * b[1] * e / (d * d)])
}

/// (b1/b2)·exp(−½((x − b3)/b2)²)
fn eckerle4(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let t = (x[0] - b[2]) / b[1];
    let e = (-0.5 * t * t).exp() / b[1];
    let y = b[0] * e;
    (y, vec![e, y * (t * t - 1.0) / b[1], y * t / b[1]])
}

/// b1/(1 + exp(b2 − b3·x))^(1/b4)
fn rat43(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let e = (b[1] - b[2] * x[0]).exp();
    let t = 1.0 + e;
    let shape = t.powf(-1.0 / b[3]);
    let y = b[0] * shape;
    let slope = y * e / (b[3] * t);
    (y, vec![shape, -slope, slope * x[0], y * t.ln() / (b[3] * b[3])])
}

/// b1·(b2 + x)^(−1/b3)
fn bennett5(b: &[f64], x: &[f64]) -> (f64, Vec<f64>) {
    let d = b[1] + x[0];
    let shape = d.powf(-1.0 / b[2]);
    let y = b[0] * shape;
    (y, vec![shape, -y / (b[2] * d), y * d.ln() / (b[2] * b[2])])
}
