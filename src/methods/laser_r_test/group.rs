//! Grouping of the scans that measure the same centre.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::bench::LaserSetup;
use super::centres::{Centres, Row, fixes_centre, frame};
use super::label::Pass;
use super::observe::Observed;
use super::settings::heights;
use super::spots::{Scanned, Spot};
use crate::Refused;
use crate::identification::declared;
use machine::{Axis, Position};

/// Assumed standard deviation of one sample if none is declared or observed, mm.
const UNDECLARED_MM: f64 = 1e-3;
/// Smallest standard uncertainty of a dwell point, which limits its weight, mm.
const LEAST_MM: f64 = 1e-6;

/// Scans of the sphere at one pose.
#[derive(Debug, Clone)]
pub struct Group {
    pub label: String,
    /// Positions of all rotary axes.
    pub rotary: Position,
    pub t_s: f64,
    /// Matrix from X, Y, Z to the machine frame.
    pub travel: Matrix3<f64>,
    /// Matrix from the machine frame to X, Y, Z.
    pub axes_for: Matrix3<f64>,
    /// Rotation from the table frame to the machine frame.
    pub table: Rotation3<f64>,
}

/// Centres to be fitted, and the origin of each row.
pub struct Grouped {
    pub groups: Vec<Group>,
    pub centres: Centres,
    /// Axis positions, samples and time of each row.
    pub spots: Vec<Spot>,
    /// For each row, the index of its scan and of the dwell point in the scan.
    pub from: Vec<(usize, usize)>,
    /// Number of different heights among the scans that determine the beam.
    pub heights: usize,
}

/// Standard deviation of one sample, mm.
pub fn noise_mm(bench: &LaserSetup<'_>, observed: &Observed) -> f64 {
    let declared = bench.sensor.noise_um.map(|um| um * 1e-3);
    let seen = observed.scatter_mm();
    match (declared, seen, &observed.latency) {
        // In motion, the jitter of both clocks adds to the scatter.
        (Some(declared), Some(seen), Some(_)) => declared.max(seen),
        _ => declared.or(seen).unwrap_or(UNDECLARED_MM),
    }
}

/// A group with its scans and their indices.
type Member<'a> = (Group, Vec<(usize, &'a Scanned)>);

/// Groups the scans by pose. Scans that do not determine a centre are removed and reported in `left_out`.
///
/// # Errors
/// No scan is left, or the linear axes do not span space.
pub fn grouped(bench: &LaserSetup<'_>, observed: &mut Observed) -> Result<Grouped, Refused> {
    let radius = bench.radius();
    let flat = |scan: &Scanned| !fixes_centre(scan, bench.beam(), radius);
    let lines = observed.scans.iter().filter(|scan| flat(scan)).map(|scan| {
        format!(
            "{}: its samples lie on one great circle or nearly, and say nothing across",
            scan.label
        )
    });
    let lines: Vec<String> = lines.collect();
    observed.left_out.extend(lines);
    observed.scans.retain(|scan| !flat(scan));
    // Scans used for the latency are not used a second time. If there are continuous scans, dwell scans are not
    // used either: their lost motion is unknown.
    let swept = observed.latency.is_some();
    let rests = |scan: &Scanned| scan.spots.iter().all(|spot| spot.velocity == Vector3::zeros());
    let only_before =
        |scan: &Scanned| matches!(scan.pass, Pass::Find | Pass::Latency) || swept && rests(scan);
    let found = observed.scans.iter().any(|scan| !only_before(scan));
    let all = observed.scans.iter().enumerate();
    let used = all.filter(|(_, scan)| !found || !only_before(scan));
    let mut members: Vec<Member<'_>> = Vec::new();
    for (index, scan) in used {
        let same = |(group, scans): &&mut Member<'_>| {
            scan.pass == Pass::Height
                && scans.iter().all(|(_, other)| other.pass == Pass::Height)
                && group.rotary == scan.rotary
        };
        match members.iter_mut().find(same) {
            Some((_, scans)) => scans.push((index, scan)),
            None => members.push((group(bench, scan)?, vec![(index, scan)])),
        }
    }
    if members.is_empty() {
        return Err(nothing(observed));
    }
    Ok(collect(bench, observed, members))
}

fn group(bench: &LaserSetup<'_>, scan: &Scanned) -> Result<Group, Refused> {
    let (label, rotary) = (scan.label.clone(), scan.rotary.clone());
    let (travel, axes_for) = (bench.travel(&rotary), bench.axes_for(&rotary)?);
    let table = bench.chain.machine_from_table(&rotary, &[]).rotation;
    Ok(Group { label, t_s: 0.0, travel, axes_for, table, rotary })
}

fn nothing(observed: &Observed) -> Refused {
    let mut why = match observed.left_out.as_slice() {
        [] => "there are no readings of the sphere".to_owned(),
        [first, ..] => format!("the sphere was not seen: {first}"),
    };
    if let Some(excluded) = observed.excluded_in_words() {
        why = format!("{why}; {excluded}");
    }
    Refused {
        why,
        instead:
            "check centre_mm of the sphere and zero_mm, direction and range_mm of the sensor; scan \
                  along two lines that cross at the pole"
                .to_owned(),
    }
}

fn collect(bench: &LaserSetup<'_>, observed: &Observed, members: Vec<Member<'_>>) -> Grouped {
    let (noise, resolution) = (noise_mm(bench, observed), resolution_mm(bench));
    let (mut groups, mut rows, mut spots) = (Vec::new(), Vec::new(), Vec::new());
    let (mut from, mut most, mut index) = (Vec::new(), 0, 0);
    for (mut group, scans) in members {
        let poles: Vec<f64> = scans.iter().map(|(_, scan)| pole(scan)).collect();
        most = most.max(heights(&poles));
        let first = spots.len();
        for (number, scan) in scans {
            for (place, spot) in scan.spots.iter().enumerate() {
                let sigma = (noise / (spot.samples as f64).sqrt()).hypot(resolution).max(LEAST_MM);
                let (at, spindle, value) = (spot.at, scan.spindle, spot.value);
                rows.push(Row { group: index, at, spindle, value, sigma });
                spots.push(*spot);
                from.push((number, place));
            }
        }
        let times = spots[first..].iter().map(|spot| spot.t_s);
        group.t_s = times.sum::<f64>() / (spots.len() - first).max(1) as f64;
        groups.push(group);
        index += 1;
    }
    let centres = Centres {
        frame: frame(bench.beam()),
        radius: bench.radius(),
        rows,
        groups: groups.len(),
        free: most >= 3 && !bench.touches(),
        round: bench.touches(),
        held: [0.0; 3],
    };
    Grouped { groups, centres, spots, from, heights: most }
}

/// Smallest reading of a scan, near the pole.
fn pole(scan: &Scanned) -> f64 {
    scan.spots.iter().map(|spot| spot.value).fold(f64::INFINITY, f64::min)
}

/// Coarsest display resolution of the linear axes as a standard uncertainty, mm.
fn resolution_mm(bench: &LaserSetup<'_>) -> f64 {
    let along = |axis: Axis| declared::resolution_mm(bench.plan, axis.direction());
    Axis::LINEAR.into_iter().map(along).fold(0.0, f64::max)
}

impl Group {
    /// Axis positions X, Y, Z of a centre given in the machine frame.
    pub fn axes(&self, centre: Vector3<f64>) -> Vector3<f64> {
        self.axes_for * centre
    }
}
