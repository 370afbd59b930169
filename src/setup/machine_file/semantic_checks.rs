//! Semantic checks of a machine file. Finite numbers are checked by the reader ([`super::LocatedValue`]), the topology
//! by `kinematics`.

use super::document::TomlDocument;
use super::error::MachineFileError;
use machine::Axis;
use machine::record::artefact::{Artefact, Cylinder, DatumCylinder};
use machine::record::machine::{Carrier, Homing, Keepout, Machine, Probe, Solid, StatedAxis};

type CheckResult = Result<(), MachineFileError>;

pub fn check_machine(document: &TomlDocument, machine: &Machine) -> CheckResult {
    document.require(!machine.name.trim().is_empty(), &["machine", "name"], "must not be empty")?;
    document.require_not_negative(&["machine", "drift_um_per_h"], machine.drift_um_per_h)?;
    document.require_not_negative(&["machine", "squareness_urad"], machine.squareness_urad)?;
    for (axis, spec) in &machine.axes {
        document.check_axis(*axis, spec)?;
    }
    document.check_axes_of_topology(machine)
}

pub fn check_probe(document: &TomlDocument, probe: &Probe) -> CheckResult {
    document.require_positive(&["probe", "ball_radius_mm"], probe.ball_radius_mm)?;
    // A repeatability of 0 would give an infinite weight. If the value is unknown, the key is omitted.
    document.require_positive(&["probe", "repeatability_um"], probe.repeatability_um.unwrap_or(1.0))?;
    document.require_not_negative(&["probe", "lobing_um"], probe.lobing_um)?;
    document.require_harmonic_orders(&["probe", "lobing_orders"], &probe.lobing_orders)?;
    document.require_not_negative(&["probe", "stylus_offset_um"], probe.u_stylus_offset_um)?;
    document.require_not_negative(&["probe", "u_stylus_length_um"], probe.u_stylus_length_um.unwrap_or_default())?;
    document.require_positive(&["probe", "qualified_within_days"], probe.qualified_within_days.unwrap_or(1.0))?;
    document.require_positive(&["probe", "overtravel_mm"], probe.overtravel_mm)?;
    document.require_positive(&["probe", "feed_mm_min"], probe.feed_mm_min)?;
    document.require_positive(&["probe", "guarded_feed_mm_min"], probe.guarded_feed_mm_min)?;
    document.require_positive(&["probe", "search_feed_mm_min"], probe.search_feed_mm_min)?;
    document.require_wait_time(&["probe", "settle_s"], probe.settle_s)?;
    document.require_not_negative(&["probe", "stem_radius_mm"], probe.stem_radius_mm)?;
    document.require_not_negative(&["probe", "stem_length_mm"], probe.stem_length_mm)?;
    document.require_not_negative(&["probe", "body_radius_mm"], probe.body_radius_mm)?;
    document.require_not_negative(&["probe", "body_length_mm"], probe.body_length_mm)?;
    document.require(
        probe.stem_radius_mm < probe.ball_radius_mm,
        &["probe", "stem_radius_mm"],
        "must be less than ball_radius_mm, so that the ball touches before the stem",
    )?;
    document.require(
        probe.body_length_mm == 0.0 || probe.stem_length_mm > 0.0,
        &["probe", "body_length_mm"],
        "requires stem_length_mm, the distance from the ball to the body",
    )
}

/// Checks a cylinder or a datum cylinder. Balls are not checked here, but where they are read.
pub fn check_artefact(document: &TomlDocument, artefact: &Artefact) -> CheckResult {
    let require_direction = |axis: &[f64; 3]| {
        document.require(*axis != [0.0; 3], &["artefact", "axis"], "must have a direction: [0, 0, 1]")
    };
    match artefact {
        Artefact::Cylinder(Cylinder { axis, radius_mm, height_mm, uncertainty_mm, .. }) => {
            require_direction(axis)?;
            document.require_positive(&["artefact", "radius_mm"], *radius_mm)?;
            document.require_positive(&["artefact", "height_mm"], *height_mm)?;
            document.require_not_negative(&["artefact", "uncertainty_mm"], *uncertainty_mm)
        }
        Artefact::DatumCylinder(DatumCylinder { axis, sections, face, uncertainty_mm, .. }) => {
            require_direction(axis)?;
            document.require(!sections.is_empty(), &["artefact", "sections"], "must not be empty")?;
            for section in sections.iter().chain(face) {
                document.require_positive(&["artefact", "radius_mm"], section.radius_mm)?;
                document.require_positive(&["artefact", "z_mm"], section.z_mm)?;
            }
            let heights = || sections.iter().chain(face).map(|section| section.z_mm);
            let rises = heights().zip(heights().skip(1)).all(|(low, high)| low < high);
            let why = "must be in rising order, with the face above all heights";
            document.require(rises, &["artefact", "sections"], why)?;
            document.require_not_negative(&["artefact", "uncertainty_mm"], *uncertainty_mm)
        }
        Artefact::Balls(_) | Artefact::None => Ok(()),
    }
}

/// Checks that each box has a positive size along each axis.
pub fn check_keepouts(document: &TomlDocument, boxes: &[Keepout]) -> CheckResult {
    for keepout in boxes {
        if keepout.min_mm.iter().zip(&keepout.max_mm).any(|(min, max)| min >= max) {
            let why = format!("the box `{}` is not valid: each min_mm must be below its max_mm", keepout.name);
            return Err(document.value_error(&["keepout"], why));
        }
    }
    Ok(())
}

/// Checks that no two entries of the list `[[section]]` have the same name.
pub fn check_unique_names<'n>(
    document: &TomlDocument,
    section: &str,
    names: impl Iterator<Item = &'n String> + Clone,
) -> CheckResult {
    for (index, name) in names.clone().enumerate() {
        if names.clone().take(index).any(|earlier| earlier == name) {
            let why = format!("the name `{name}` occurs twice: use different names");
            return Err(document.entry_value_error(&[section], index, "name", why));
        }
    }
    Ok(())
}

/// Checks that each solid has a unique name, a carrier that the machine has, and a positive size in each dimension.
pub fn check_solids(document: &TomlDocument, solids: &[Solid], machine: &Machine) -> CheckResult {
    for (index, solid) in solids.iter().enumerate() {
        let name = solid.name.as_str();
        let require = |holds: bool, key: &str, why: String| {
            if holds { Ok(()) } else { Err(document.entry_value_error(&["solid"], index, key, why)) }
        };
        require(!name.trim().is_empty(), "name", "must not be empty".to_owned())?;
        let is_unique = solids.iter().filter(|other| other.name == name).count() == 1;
        require(is_unique, "name", format!("is `{name}`, which occurs twice: use different names"))?;
        if let Carrier::Axis(axis) = solid.on {
            let there = machine.axes.contains_key(&axis);
            require(there, "on", format!("is {axis}, but this machine has no axis {axis}"))?;
        }
        let mut sides = solid.from_mm.iter().zip(&solid.to_mm).map(|(from, to)| from != to);
        match solid.radius_mm {
            Some(radius) => {
                let why = format!("is {radius}; it must be greater than 0");
                require(radius > 0.0, "radius_mm", why)?;
                let why = "is equal to from_mm: the two ends of the cylinder axis must differ";
                require(sides.any(|apart| apart), "to_mm", why.to_owned())?;
            }
            None => {
                let why = "describes a box of zero thickness: the corners must differ in x, y and z";
                require(sides.all(|apart| apart), "to_mm", why.to_owned())?;
            }
        }
    }
    Ok(())
}

impl TomlDocument {
    /// An error at `key` unless `is_valid`; `why` continues a sentence that begins with the key.
    fn require(&self, is_valid: bool, key: &[&str], why: &str) -> CheckResult {
        if is_valid { Ok(()) } else { Err(self.value_error(key, why)) }
    }

    fn require_positive(&self, key: &[&str], value: f64) -> CheckResult {
        self.require(value > 0.0, key, &format!("is {value}; it must be greater than 0"))
    }

    fn require_not_negative(&self, key: &[&str], value: f64) -> CheckResult {
        self.require(value >= 0.0, key, &format!("is {value}; it must not be negative"))
    }

    /// Checks harmonic orders: from 2 to 100, each once; order 1 is an eccentricity.
    fn require_harmonic_orders(&self, key: &[&str], orders: &[u32]) -> CheckResult {
        let is_new = |(i, order): (usize, &u32)| !orders[..i].contains(order);
        let sound = orders.iter().all(|order| (2..=100).contains(order)) && orders.iter().enumerate().all(is_new);
        self.require(sound, key, "must list harmonic orders from 2 to 100, each once")
    }

    /// Checks a waiting time: from 0 to 10 s, so that the wait is not mistaken for a failure of the control.
    fn require_wait_time(&self, key: &[&str], seconds: f64) -> CheckResult {
        let why = format!("is {seconds}; it must be from 0 to 10 s");
        self.require((0.0..=10.0).contains(&seconds), key, &why)
    }

    fn check_axis(&self, axis: Axis, spec: &StatedAxis) -> CheckResult {
        let name = axis.to_string();
        let key = |key: &'static str| ["axes", name.as_str(), key];
        let order = format!("is {}; it must be greater than min = {}", spec.max, spec.min);
        self.require(spec.min < spec.max, &key("max"), &order)?;
        self.require_positive(&key("rapid_per_min"), spec.rapid_per_min)?;
        self.require_positive(&key("acceleration_per_s2"), spec.acceleration_per_s2)?;
        self.require_not_negative(&key("resolution_um"), spec.resolution_um)?;
        self.require_not_negative(&key("error_motion_um"), spec.error_motion_um)?;
        self.require_harmonic_orders(&key("error_motion_orders"), &spec.error_motion_orders)?;
        let turns = !axis.is_linear() && axis != Axis::S;
        let has_no_orders = turns || spec.error_motion_orders.is_empty();
        let why = "is allowed for the axes A, B and C only: remove it";
        self.require(has_no_orders, &key("error_motion_orders"), why)?;
        self.require_not_negative(&key("backlash_um"), spec.backlash_um)?;
        self.require_not_negative(&key("angular_motion_urad"), spec.angular_motion_urad)?;
        let has_no_backlash = axis.is_linear() || spec.backlash_um == 0.0;
        self.require(has_no_backlash, &key("backlash_um"), "is allowed for the axes X, Y and Z only: remove it")?;
        let homes = turns || spec.homing == Homing::Switch;
        self.require(homes, &key("homing"), "is `none`, which is allowed for the axes A, B and C only")?;
        if let Some(clamp) = &spec.clamp {
            self.require(turns, &key("clamp"), "is allowed for the axes A, B and C only: remove it here")?;
            self.require_wait_time(&["axes", &name, "clamp", "wait_s"], clamp.wait_s)?;
        }
        let why = format!("is {}; it must be at least 1 mm", spec.error_wavelength_mm);
        self.require(spec.error_wavelength_mm >= 1.0, &key("error_wavelength_mm"), &why)
    }

    /// Checks that every moving axis of the topology has limits, and that there are no limits for other axes: a
    /// mistyped axis would leave the true axis without limits. The spindle S needs no limits.
    fn check_axes_of_topology(&self, machine: &Machine) -> CheckResult {
        let named = topology_axes(&machine.topology);
        let topology = &machine.topology;
        if let Some(axis) = named.iter().find(|axis| !machine.axes.contains_key(axis)) {
            let why = format!(
                "contains {axis}, but the section [axes.{axis}] is missing: add the section with the limits of the axis"
            );
            return self.require(false, &["machine", "topology"], &why);
        }
        match machine.axes.keys().find(|axis| **axis != Axis::S && !named.contains(axis)) {
            None => Ok(()),
            Some(axis) => {
                let name = axis.to_string();
                let why = format!("is present, but the topology `{topology}` has no such axis");
                self.require(false, &["axes", &name], &why)
            }
        }
    }
}

/// The linear and rotary axes that a topology names; `(C)` is the spindle, `F`, `b`, `w`, `t` do not move.
fn topology_axes(topology: &str) -> Vec<Axis> {
    let mut depth = 0;
    let mut axes = Vec::new();
    for letter in topology.chars() {
        match letter {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ if depth == 0 => {
                axes.extend(Axis::ALL.into_iter().filter(|axis| *axis != Axis::S && axis.letter() == letter))
            }
            _ => {}
        }
    }
    axes
}
