//! The true datum cylinder on its indexing stage: one cylinder for each cross section, each with its own form, and a
//! face that is not quite flat.

use std::ops::RangeInclusive;

use nalgebra::{Rotation3, Vector3};

use super::SimulatedWorldError;
use super::datum_cylinder_truth::IndexingStageTruth;
use super::nearest_surface::NearestSurface;
use super::random_draws::{RandomSource, draw_form_harmonics, draw_normal};
use super::true_round_part::{FormHarmonic, RadiusProfile, TrueCylinder};
use super::truth::MachineTruth;
use machine::frame::unit_vector;
use machine::record::artefact::DatumCylinder;

/// The datum cylinder with its true form, as it is mounted on its indexing stage.
#[derive(Debug, Clone)]
pub(super) struct TrueDatumCylinder {
    stated: DatumCylinder,
    /// Profiles of the stated cross sections, in their order.
    profiles: Vec<RadiusProfile>,
    /// Height of the face over the angle about the axis, drawn and stated.
    face_form: Vec<FormHarmonic>,
    /// True foot of the axis in the first mounting, table frame, mm.
    first_mounting_axis_foot: Vector3<f64>,
    /// Tilt of the axis towards X and towards Y, without the tilt of a new mounting.
    tilt_rad: [f64; 2],
    stage_truth: IndexingStageTruth,
    seed: u64,
    /// Number of mountings after the first.
    remounting_count: u32,
    /// Requested angle of the present mounting against the first, without errors of the stage.
    turn_deg: f64,
    mounted_cylinder: MountedDatumCylinder,
}

/// The cylinder as it is mounted now, table frame, with the errors of this mounting.
#[derive(Debug, Clone)]
struct MountedDatumCylinder {
    /// One cylinder for each cross section; it extends half-way to its neighbours, the first from the foot, the last
    /// to the end.
    true_cross_sections: Vec<TrueCylinder>,
    axis_foot: Vector3<f64>,
    /// Columns: the x, y and axis directions of the artefact.
    frame: Rotation3<f64>,
}

impl TrueDatumCylinder {
    pub fn new(stated: &DatumCylinder, truth: &MachineTruth) -> Result<Self, SimulatedWorldError> {
        let own = &truth.datum_cylinder;
        let sections_exist = own.section_form.iter().all(|form| (1..=stated.sections.len()).contains(&form.section));
        let section_form = |section| {
            draw_form_harmonics(truth.seed, RandomSource::SectionForm, &[section], SECTION_FORM_ORDERS, own.form_um)
        };
        let profile = |(number, section): (usize, &machine::record::artefact::DatumCrossSection)| {
            let drawn = section_form(number as u64);
            let listed = own.section_form.iter().filter(|form| form.section == number + 1);
            let listed = listed.map(|f| FormHarmonic { n: f.n, cos_um: f.cos_um, sin_um: f.sin_um });
            let form = truth.form.iter().copied().chain(drawn).chain(listed);
            RadiusProfile::new(section.radius_mm + truth.radius_offset_mm, form)
        };
        let profiles: Vec<RadiusProfile> = stated.sections.iter().enumerate().map(profile).collect();
        let mut face_form = section_form(FACE_DRAW_KEY);
        face_form.extend(&own.face_form);
        let is_valid = unit_vector(Vector3::from(stated.axis)).is_some()
            && sections_exist
            && !profiles.is_empty()
            && profiles.iter().all(|profile| profile.min_radius_bound() > 0.0);
        if !is_valid {
            return Err(SimulatedWorldError::InvalidDatumCylinder);
        }
        let foot = Vector3::from(stated.foot_mm) + truth.artefact_offset_mm();
        let tilt = own.tilt_urad.map(|urad| urad * 1e-6);
        let mut datum = Self {
            stated: stated.clone(),
            profiles,
            face_form,
            first_mounting_axis_foot: foot,
            tilt_rad: tilt,
            stage_truth: truth.stage.clone(),
            seed: truth.seed,
            remounting_count: 0,
            turn_deg: 0.0,
            mounted_cylinder: MountedDatumCylinder {
                true_cross_sections: Vec::new(),
                axis_foot: foot,
                frame: Rotation3::identity(),
            },
        };
        datum.mounted_cylinder = datum.compute_mounted_cylinder(0.0, [0.0; 2], datum.tilt_rad);
        Ok(datum)
    }

    /// Mounts the cylinder again at this angle against the first mounting, counter-clockwise seen from its tip. Does
    /// nothing if it is already at this angle.
    pub fn remount(&mut self, turn_deg: f64) {
        if turn_deg == self.turn_deg {
            return;
        }
        self.remounting_count += 1;
        self.turn_deg = turn_deg;
        let draw =
            |part| draw_normal(self.seed, RandomSource::MountingError, &[u64::from(self.remounting_count), part]);
        let IndexingStageTruth { index_error_urad, eccentricity_um, tilt_urad, faults } = &self.stage_truth;
        let matching_faults = faults.iter().filter(|fault| fault.mounting == self.remounting_count);
        let off_deg = matching_faults.map(|fault| fault.off_deg).sum::<f64>();
        let turn = (turn_deg + off_deg).to_radians() + index_error_urad * 1e-6 * draw(0);
        let shift = [1, 2].map(|part| eccentricity_um * 1e-3 * draw(part));
        let lean = [3, 4].map(|part| tilt_urad * 1e-6 * draw(part));
        self.mounted_cylinder =
            self.compute_mounted_cylinder(turn, shift, [self.tilt_rad[0] + lean[0], self.tilt_rad[1] + lean[1]]);
    }

    /// The cylinder turned by `turn`, rad, shifted by `shift` along X and Y, mm, with its axis tilted by `tilt`, rad.
    fn compute_mounted_cylinder(&self, turn: f64, shift: [f64; 2], tilt: [f64; 2]) -> MountedDatumCylinder {
        let axis = unit_vector(Vector3::from(self.stated.axis)).unwrap_or(Vector3::z());
        let axis = (axis + Vector3::new(tilt[0], tilt[1], 0.0)).normalize();
        let foot = self.first_mounting_axis_foot + Vector3::new(shift[0], shift[1], 0.0);
        let bounds = self.section_boundary_heights_mm();
        let section = |(number, profile): (usize, &RadiusProfile)| {
            let (from, to) = (bounds[number], bounds[number + 1]);
            TrueCylinder::new(foot + axis * from, axis, to - from, profile.clone()).rotated_about_axis(turn)
        };
        let sections: Vec<TrueCylinder> = self.profiles.iter().enumerate().map(section).collect();
        let frame = sections.first().map_or(Rotation3::identity(), |section| section.frame);
        MountedDatumCylinder { true_cross_sections: sections, axis_foot: foot, frame }
    }

    /// Heights of the boundaries between sections above the foot, one more than sections, from 0 to the end; sections
    /// are stated in rising order.
    fn section_boundary_heights_mm(&self) -> Vec<f64> {
        let sections = &self.stated.sections;
        let middle = sections.windows(2).map(|pair| (pair[0].z_mm + pair[1].z_mm) / 2.0);
        let last = sections.last().map_or(0.0, |section| section.z_mm + END_ABOVE_LAST_SECTION_MM);
        let end = self.stated.face.map_or(last, |face| face.z_mm);
        std::iter::once(0.0).chain(middle).chain([end]).collect()
    }

    /// Surface nearest to `point`, both in the table frame; `growth` is added to the radius.
    pub fn nearest(&self, point: Vector3<f64>, growth: f64) -> NearestSurface {
        let far = NearestSurface::no_surface_within(f64::INFINITY);
        let MountedDatumCylinder { true_cross_sections: sections, axis_foot: foot, frame } = &self.mounted_cylinder;
        let nearer = |best: NearestSurface, section: &TrueCylinder| {
            let is_farther = section.distance_lower_bound(point) > best.signed_distance;
            if is_farther { best } else { best.or_nearer(section.nearest(point, growth)) }
        };
        let mut nearest = sections.iter().fold(far, nearer);
        let own = frame.inverse() * (point - foot);
        // The form of the face is micrometres over millimetres, so that its slope does not change the distance.
        if nearest.outward_normal.dot(&(*frame * Vector3::z())) > 0.5 {
            let angle = own.y.atan2(own.x);
            nearest.signed_distance -= self.face_form.iter().map(|form| form_height_mm(form, angle)).sum::<f64>();
        }
        nearest
    }
}

/// Orders of the drawn form of a section and of the face.
const SECTION_FORM_ORDERS: RangeInclusive<u32> = 2..=20;
/// Key of the face among the sections, for the random draws.
const FACE_DRAW_KEY: u64 = u64::MAX;
/// Height of the end above the last section of a cylinder without a face, mm.
const END_ABOVE_LAST_SECTION_MM: f64 = 20.0;

fn form_height_mm(form: &FormHarmonic, angle: f64) -> f64 {
    let (sin, cos) = (f64::from(form.n) * angle).sin_cos();
    (form.cos_um * cos + form.sin_um * sin) * 1e-3
}
