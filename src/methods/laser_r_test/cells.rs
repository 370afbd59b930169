//! Samples of a continuous scan, grouped by cells of axis positions, so that the fit of all scans stays small. A
//! cell holds the samples of all passes through it, forward and backward.
//!
//! The mean of samples on a sphere lies below its surface: by w²/24R along a path of w, 1.8 um for 0.65 mm on R =
//! 10 mm. Therefore the deviations of the samples from a sphere fitted to this scan alone are averaged, not the
//! samples. The remaining chord error is of third order. Cells without samples get no value.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::bench::LaserSetup;
use super::centres::{Centres, Row, frame};
use super::spots::{Scanned, Spot};
use super::track::TimedSample;
use machine::Axis;
use machine::frame::unit_vector;

/// Minimum number of samples of a motion along one line.
const LEAST_SAMPLES: usize = 10;
/// Minimum cosine of the angle between a motion and its line.
const ALONG: f64 = 0.95;
/// Minimum width of a cell, mm.
const LEAST_MM: f64 = 0.01;

/// One spot for each cell of this scan in the order of time, and the scatter within cells: Σ(sample less mean)² in
/// mm² with its degrees of freedom. The spots of `scan` are not used.
pub fn cells(
    bench: &LaserSetup<'_>,
    scan: &Scanned,
    seen: &[TimedSample],
) -> (Vec<Spot>, (f64, usize)) {
    let travel = bench.travel(&scan.rotary);
    let mut within = (0.0, 0);
    let Some(sphere) = Sphere::of(bench, (travel, scan.spindle), seen) else {
        return (Vec::new(), within);
    };
    let spot = |all: Vec<&TimedSample>| {
        let off = |one: &&TimedSample| Some(one.value - sphere.reading(travel * one.xyz)?);
        let offs: Vec<f64> = all.iter().map(off).collect::<Option<_>>()?;
        let (count, mean_off) = (offs.len() as f64, offs.iter().sum::<f64>() / offs.len() as f64);
        let mean = |pick: fn(&TimedSample) -> Vector3<f64>| {
            all.iter().map(|s| pick(s)).sum::<Vector3<f64>>() / count
        };
        let xyz = mean(|seen| seen.xyz);
        let value = sphere.reading(travel * xyz)? + mean_off;
        within.0 += offs.iter().map(|off| (off - mean_off).powi(2)).sum::<f64>();
        within.1 += offs.len() - 1;
        Some(Spot {
            xyz,
            at: travel * xyz,
            value,
            samples: offs.len(),
            t_s: all.iter().map(|seen| seen.t_s).sum::<f64>() / count,
            velocity: mean(|seen| seen.velocity),
            last_motion_sign: mean(|seen| seen.last_motion_sign),
        })
    };
    let spots = group_by_cell(bench, seen).into_iter().filter_map(spot).collect();
    (spots, within)
}

/// Groups the samples of one scan by cells. The cells are in the order of time.
pub fn group_by_cell<'a>(
    bench: &LaserSetup<'_>,
    seen: &'a [TimedSample],
) -> Vec<Vec<&'a TimedSample>> {
    let width = (extent(seen) / bench.settings.points.max(1) as f64).max(LEAST_MM);
    let (mut cells, mut numbers) = (Vec::<Vec<&TimedSample>>::new(), BTreeMap::new());
    for one in seen {
        let place: [i64; 3] = one.xyz.map(|mm| (mm / width).floor() as i64).into();
        let number = *numbers.entry(place).or_insert(cells.len());
        match cells.get_mut(number) {
            Some(cell) => cell.push(one),
            None => cells.push(vec![one]),
        }
    }
    cells
}

/// Longest side of the range of the scan, mm.
fn extent(seen: &[TimedSample]) -> f64 {
    let xyz = || seen.iter().map(|seen| seen.xyz);
    let most = xyz().fold(Vector3::repeat(f64::NEG_INFINITY), |most, xyz| most.sup(&xyz));
    let least = xyz().fold(Vector3::repeat(f64::INFINITY), |least, xyz| least.inf(&xyz));
    (most - least).max()
}

/// Sphere fitted to one scan alone, with the nominal beam.
pub struct Sphere {
    centre: Vector3<f64>,
    radius: f64,
    /// Direction of the beam, machine frame.
    beam: Vector3<f64>,
}

impl Sphere {
    /// Fits the sphere. `travel`: from X, Y, Z to the machine frame. `spindle`: from the spindle frame to the
    /// machine frame. `None`: the samples do not determine the sphere.
    pub fn of(
        bench: &LaserSetup<'_>,
        (travel, spindle): (Matrix3<f64>, Rotation3<f64>),
        seen: &[TimedSample],
    ) -> Option<Self> {
        let row = |one: &TimedSample| Row {
            group: 0,
            at: travel * one.xyz,
            spindle,
            value: one.value,
            sigma: LEAST_MM,
        };
        let centres = Centres {
            frame: frame(bench.beam()),
            radius: bench.radius(),
            rows: seen.iter().map(row).collect(),
            groups: 1,
            free: false,
            round: false,
            held: [0.0; 3],
        };
        let centre = centres.centre(&centres.solve().ok()?.x, 0);
        Some(Self { centre, radius: bench.radius(), beam: spindle * bench.beam() })
    }

    /// Reading of the sensor with the spindle at `at`. `None`: the beam misses the sphere.
    pub fn reading(&self, at: Vector3<f64>) -> Option<f64> {
        let from = at - self.centre;
        let half = from.dot(&self.beam);
        let root = half * half - from.norm_squared() + self.radius * self.radius;
        (root > 0.0).then(|| -half - root.sqrt())
    }

    /// Derivative of [`reading`](Self::reading) with respect to `at`.
    pub fn slope(&self, at: Vector3<f64>) -> Option<Vector3<f64>> {
        let normal = at + self.beam * self.reading(at)? - self.centre;
        Some(-normal / normal.dot(&self.beam))
    }
}

/// Descriptions of the motions along `path` (X, Y, Z) that have too few samples.
pub fn thin_ways(path: &[Vector3<f64>], seen: &[TimedSample]) -> Vec<String> {
    let mut thin: Vec<String> = Vec::new();
    for pair in path.windows(2) {
        let Some(way) = unit_vector(pair[1] - pair[0]) else { continue };
        let along =
            |one: &&TimedSample| unit_vector(one.velocity).unwrap_or_default().dot(&way) > ALONG;
        let count = seen.iter().filter(along).count();
        let words = format!("{count} samples of its way along {}", name(way));
        if count < LEAST_SAMPLES && !thin.contains(&words) {
            thin.push(words);
        }
    }
    thin
}

/// Name of the axis with the largest motion, with its sign.
fn name(way: Vector3<f64>) -> String {
    let most = Axis::LINEAR.into_iter().zip(way.iter().copied());
    let most = most.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
    most.map_or_else(String::new, |(axis, part)| {
        format!("{}{axis}", if part < 0.0 { '-' } else { '+' })
    })
}
