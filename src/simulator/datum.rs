//! The true datum cylinder on its indexing stage: one cylinder for each section, each with its own form, and a
//! face that is not quite flat.

use nalgebra::{Rotation3, Vector3};

use super::WorldError;
use super::datum_truth::StageTruth;
use super::drawn;
use super::flank::{Flank, FormHarmonic, Profile};
use super::nearest::Nearest;
use super::truth::Truth;
use machine::frame::unit_vector;
use machine::record::artefact::DatumCylinder;

/// Pose of the artefact in the table frame.
#[derive(Debug, Clone)]
pub(super) struct Datum {
    stated: DatumCylinder,
    /// Profiles of the stated sections, in their order.
    profiles: Vec<Profile>,
    face_form: Vec<FormHarmonic>,
    foot: Vector3<f64>,
    tilt: [f64; 2],
    stage: StageTruth,
    seed: u64,
    /// Number of mountings after the first.
    mounted: u32,
    turn_deg: f64,
    standing: Standing,
}

#[derive(Debug, Clone)]
struct Standing {
    flanks: Vec<Flank>,
    foot: Vector3<f64>,
    /// Columns: the x, y and axis directions of the artefact.
    frame: Rotation3<f64>,
}

impl Datum {
    pub fn new(stated: &DatumCylinder, truth: &Truth) -> Result<Self, WorldError> {
        let own = &truth.datum_cylinder;
        let named =
            own.section_form.iter().all(|form| (1..=stated.sections.len()).contains(&form.section));
        let profile = |(number, section): (usize, &machine::record::artefact::Section)| {
            let drawn = drawn::section_form(truth.seed, number as u64, own.form_um);
            let listed = own.section_form.iter().filter(|form| form.section == number + 1);
            let listed =
                listed.map(|f| FormHarmonic { n: f.n, cos_um: f.cos_um, sin_um: f.sin_um });
            let form = truth.form.iter().copied().chain(drawn).chain(listed);
            Profile::new(section.radius_mm + truth.radius_offset_mm, form)
        };
        let profiles: Vec<Profile> = stated.sections.iter().enumerate().map(profile).collect();
        let mut face_form = drawn::section_form(truth.seed, FACE, own.form_um);
        face_form.extend(&own.face_form);
        let sound = unit_vector(Vector3::from(stated.axis)).is_some()
            && named
            && !profiles.is_empty()
            && profiles.iter().all(|profile| profile.smallest_radius() > 0.0);
        if !sound {
            return Err(WorldError::DatumCylinder);
        }
        let foot = Vector3::from(stated.centre_mm) + truth.centre_offset();
        let tilt = own.tilt_urad.map(|urad| urad * 1e-6);
        let mut datum = Self {
            stated: stated.clone(),
            profiles,
            face_form,
            foot,
            tilt,
            stage: truth.stage.clone(),
            seed: truth.seed,
            mounted: 0,
            turn_deg: 0.0,
            standing: Standing { flanks: Vec::new(), foot, frame: Rotation3::identity() },
        };
        datum.standing = datum.stands(0.0, [0.0; 2], datum.tilt);
        Ok(datum)
    }

    /// Mounts the artefact at this angle against the first mounting, counter-clockwise seen from its tip. Does
    /// nothing if it is already at this angle.
    pub fn mount(&mut self, turn_deg: f64) {
        if turn_deg == self.turn_deg {
            return;
        }
        self.mounted += 1;
        self.turn_deg = turn_deg;
        let draw = |part| drawn::mounting(self.seed, self.mounted, part);
        let StageTruth { index_error_urad, eccentricity_um, tilt_urad, faults } = &self.stage;
        let off = faults.iter().filter(|fault| fault.mounting == self.mounted);
        let off_deg = off.map(|fault| fault.off_deg).sum::<f64>();
        let turn = (turn_deg + off_deg).to_radians() + index_error_urad * 1e-6 * draw(0);
        let shift = [1, 2].map(|part| eccentricity_um * 1e-3 * draw(part));
        let lean = [3, 4].map(|part| tilt_urad * 1e-6 * draw(part));
        self.standing = self.stands(turn, shift, [self.tilt[0] + lean[0], self.tilt[1] + lean[1]]);
    }

    fn stands(&self, turn: f64, shift: [f64; 2], tilt: [f64; 2]) -> Standing {
        let axis = unit_vector(Vector3::from(self.stated.axis)).unwrap_or(Vector3::z());
        let axis = (axis + Vector3::new(tilt[0], tilt[1], 0.0)).normalize();
        let foot = self.foot + Vector3::new(shift[0], shift[1], 0.0);
        let bounds = self.bounds();
        let flank = |(number, profile): (usize, &Profile)| {
            let (from, to) = (bounds[number], bounds[number + 1]);
            Flank::new(foot + axis * from, axis, to - from, profile.clone()).turned(turn)
        };
        let flanks: Vec<Flank> = self.profiles.iter().enumerate().map(flank).collect();
        let frame = flanks.first().map_or(Rotation3::identity(), |flank| *flank.frame());
        Standing { flanks, foot, frame }
    }

    /// Heights of the boundaries between sections, from the foot to the end; sections are stated in rising
    /// order.
    fn bounds(&self) -> Vec<f64> {
        let sections = &self.stated.sections;
        let middle = sections.windows(2).map(|pair| (pair[0].z_mm + pair[1].z_mm) / 2.0);
        let last = sections.last().map_or(0.0, |section| section.z_mm + END_MM);
        let end = self.stated.face.map_or(last, |face| face.z_mm);
        std::iter::once(0.0).chain(middle).chain([end]).collect()
    }

    /// Nearest surface to `point` in the table frame; `growth` is added to the radius.
    pub fn nearest(&self, point: Vector3<f64>, growth: f64) -> Nearest {
        let far = Nearest { distance: f64::INFINITY, normal: Vector3::z() };
        let Standing { flanks, foot, frame } = &self.standing;
        let nearer = |best: Nearest, flank: &Flank| {
            if flank.at_least(point) > best.distance {
                return best;
            }
            let own = flank.nearest(point, growth);
            if own.distance < best.distance { own } else { best }
        };
        let mut nearest = flanks.iter().fold(far, nearer);
        let own = frame.inverse() * (point - foot);
        // The form of the face is micrometres over millimetres, so that its slope does not change the distance.
        if nearest.normal.dot(&(*frame * Vector3::z())) > 0.5 {
            let angle = own.y.atan2(own.x);
            nearest.distance -=
                self.face_form.iter().map(|form| height_mm(form, angle)).sum::<f64>();
        }
        nearest
    }
}

/// Key of the face among the sections, for the random draws.
const FACE: u64 = u64::MAX;
/// Height of the end above the last section of a cylinder without a face, mm.
const END_MM: f64 = 20.0;

fn height_mm(form: &FormHarmonic, angle: f64) -> f64 {
    let (sin, cos) = (f64::from(form.n) * angle).sin_cos();
    (form.cos_um * cos + form.sin_um * sin) * 1e-3
}
