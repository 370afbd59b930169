pub struct Interpolant {
    c: Vec<f64>,
    s: Vec<f64>,
    n: usize,
}
impl Interpolant {
    pub fn new(y: &[f64]) -> Self {
        let n = y.len();
        let h = n / 2;
        let f = |k: usize, g: fn(f64) -> f64| {
            y.iter()
                .enumerate()
                .map(|(i, v)| v * g(std::f64::consts::TAU * (i * k) as f64 / n as f64))
                .sum::<f64>()
                * 2.0
                / n as f64
        };
        Self {
            c: (0..=h).map(|k| f(k, f64::cos)).collect(),
            s: (0..=h).map(|k| f(k, f64::sin)).collect(),
            n,
        }
    }
    pub fn derivative(&self, t: f64) -> f64 {
        (1..self.c.len())
            .map(|k| {
                if 2 * k == self.n {
                    return 0.0;
                }
                let kf = k as f64;
                kf * (-self.c[k] * (kf * t).sin() + self.s[k] * (kf * t).cos())
            })
            .sum()
    }
}
