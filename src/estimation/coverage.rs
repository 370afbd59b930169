use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};
pub fn factor(dof: Option<f64>) -> f64 {
    match dof {
        None => 2.0,
        Some(d) => {
            StudentsT::new(0.0, 1.0, d.max(1.0)).map_or(2.0, |t| t.inverse_cdf(0.5 + 0.9545 / 2.0))
        }
    }
}
pub fn chi_square_bounds(dof: usize, p: f64) -> (f64, f64) {
    let c = ChiSquared::new(dof as f64).unwrap();
    (c.inverse_cdf(0.5 - p / 2.0), c.inverse_cdf(0.5 + p / 2.0))
}
pub fn tolerance(u: f64, digits: i32) -> f64 {
    0.5 * 10f64.powi(u.log10().floor() as i32 - digits + 1)
}
