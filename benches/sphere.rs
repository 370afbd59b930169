//! Sphere fit to 1 000 000 samples of a scan, with residuals and covariance, compared with
//! `scipy.optimize.least_squares(method="lm")` with the analytic Jacobian on the same data. The time to read the
//! data is excluded on both sides.
//!
//! `cargo bench --bench sphere`. scipy is installed into a separate venv in the target folder.

use std::error::Error;
use std::f64::consts::TAU;
use std::process::Command;
use std::time::Instant;

use estimation::random;
use estimation::sphere::{FittedSphere, fit_sphere};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

mod peer;

use peer::{run_and_read_numbers, scipy_folder, scipy_python};

const SAMPLE_COUNT: usize = 1_000_000;
const SPHERE_CENTRE_MM: [f64; 3] = [100.0, -50.0, 300.0];
const SPHERE_RADIUS_MM: f64 = 10.0;
const NOISE_STD_MM: f64 = 0.5e-3;
/// Maximum angle from the pole at which the beam has an echo.
const CAP_HALF_ANGLE_DEG: f64 = 30.0;
/// Minimum ratio of the time of scipy to the time of `trued`.
const MIN_SPEEDUP_OVER_SCIPY: f64 = 10.0;
const SCIPY_SCRIPT: &str = include_str!("sphere_scipy.py");

fn main() -> Result<(), Box<dyn Error>> {
    let points = generate_cap_samples();
    let (ours_s, ours) = time_sphere_fit(&points)?;
    println!("trued: {:.2} ms for the sphere of {SAMPLE_COUNT} samples", ours_s * 1e3);
    let found = scipy_python().and_then(|python| {
        let bytes: Vec<u8> = points.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let (script, input) = (scipy_folder().join("sphere.py"), scipy_folder().join("sphere.f64"));
        std::fs::write(&script, SCIPY_SCRIPT)?;
        std::fs::write(&input, bytes)?;
        let command = || {
            let mut command = Command::new(&python);
            command.arg(&script).arg(&input);
            command
        };
        let one = run_and_read_numbers(command().env("OPENBLAS_NUM_THREADS", "1"))?;
        let all = run_and_read_numbers(&mut command())?;
        Ok(if one[0] < all[0] { one } else { all })
    });
    let theirs = match found {
        Ok(found) => found,
        Err(why) if std::env::var_os("TRUED_REQUIRE_PEERS").is_none() => {
            println!("scipy: skipped, {why}");
            return Ok(());
        }
        Err(why) => return Err(why),
    };
    for (k, found) in ours.centre.into_iter().chain([ours.radius]).enumerate() {
        // A picometre; the uncertainty from the noise is ten nanometres.
        if (found - theirs[k + 1]).abs() > 1e-9 {
            return Err(format!("unknown {k}: {found} against {} of scipy", theirs[k + 1]).into());
        }
    }
    let ratio = theirs[0] / ours_s;
    println!("scipy: {:.1} ms\nratio: {ratio:.1}", theirs[0] * 1e3);
    if ratio < MIN_SPEEDUP_OVER_SCIPY {
        return Err(format!("less than {MIN_SPEEDUP_OVER_SCIPY} times as fast as scipy").into());
    }
    Ok(())
}

/// Best of twenty runs: seconds, and the sphere.
fn time_sphere_fit(points: &[[f64; 3]]) -> Result<(f64, FittedSphere), Box<dyn Error>> {
    let (mut best, sphere) = (f64::INFINITY, fit_sphere(points)?);
    for _ in 0..20 {
        let start = Instant::now();
        fit_sphere(points)?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok((best, sphere))
}

/// Samples distributed evenly over the cap.
fn generate_cap_samples() -> Vec<[f64; 3]> {
    let mut stream = random::seeded_stream(1, &[3]);
    let lowest = CAP_HALF_ANGLE_DEG.to_radians().cos();
    let sample = |_| {
        let (z, turn) = (stream.random_range(lowest..1.0), stream.random_range(0.0..TAU));
        let noise: f64 = StandardNormal.sample(&mut stream);
        let (radius, level) = (SPHERE_RADIUS_MM + NOISE_STD_MM * noise, (1.0 - z * z).sqrt());
        let direction = [level * turn.cos(), level * turn.sin(), z];
        std::array::from_fn(|k| SPHERE_CENTRE_MM[k] + radius * direction[k])
    };
    (0..SAMPLE_COUNT).map(sample).collect()
}
