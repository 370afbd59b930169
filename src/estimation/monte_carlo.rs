use rand_chacha::ChaCha8Rng;
#[derive(Default)]
pub enum Trials {
    #[default]
    Adaptive,
    Fixed(usize),
}
pub struct Summary {
    pub trials: usize,
    pub standard_deviation: Vec<f64>,
}
#[derive(Debug, thiserror::Error)]
#[error("x")]
pub struct E;
pub fn run(
    t: Trials,
    seed: u64,
    n: usize,
    f: impl Fn(&mut ChaCha8Rng, &mut [f64]) + Sync,
) -> Result<Summary, E> {
    let trials = match t {
        Trials::Adaptive => 10000,
        Trials::Fixed(n) => n,
    };
    let mut rng = crate::base::random::stream(seed, &[0]);
    let (mut s, mut q, mut o) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    let mut z: Option<Vec<f64>> = None;
    for _ in 0..trials {
        f(&mut rng, &mut o);
        let z = z.get_or_insert_with(|| o.clone());
        for i in 0..n {
            let d = o[i] - z[i];
            s[i] += d;
            q[i] += d * d;
        }
    }
    let m = trials as f64;
    Ok(Summary {
        trials,
        standard_deviation: (0..n)
            .map(|i| (q[i] / m - (s[i] / m).powi(2)).max(0.0).sqrt())
            .collect(),
    })
}
