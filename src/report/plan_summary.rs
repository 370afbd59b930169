//! Summary of the plan as a table: instruments, artefact and number of measurements.

use super::number;
use super::rows::NameTextRows;
use machine::record::artefact::{Artefact, Balls, Cylinder, DatumCrossSection, DatumCylinder};
use machine::record::plan::{Plan, StepKind};
use machine::record::sensor::{Sensor, SensorMount};

pub fn plan_rows(plan: &Plan) -> NameTextRows {
    let mut rows = vec![("Topology".to_owned(), plan.machine.topology.clone())];
    rows.extend(instrument_rows(plan));
    rows.push(("Artefact".to_owned(), describe_artefact(&plan.artefact)));
    rows.push(("Steps".to_owned(), describe_step_counts(plan)));
    let settings = plan.settings.as_object().into_iter().flatten();
    rows.extend(settings.map(|(key, value)| (format!("Setting {key}"), value.to_string())));
    rows
}

/// The measuring instrument: the sensors that replace the probe, otherwise the stylus.
fn instrument_rows(plan: &Plan) -> NameTextRows {
    let stylus = [
        ("Stylus tip from spindle datum".to_owned(), format_vector_mm(plan.machine.tool_mm)),
        ("Stylus ball radius".to_owned(), format!("{} mm", plan.probe.ball_radius_mm)),
    ];
    let row = |sensor: &Sensor| {
        let ([least, most], [i, j, k]) = (sensor.range_mm, sensor.direction);
        let noise = sensor.noise_um.map_or(String::new(), |um| format!(", noise {um} µm declared"));
        let text = format!(
            "zero point {} {}, positive direction ({i}, {j}, {k}) (both nominal), range {least} to {most} mm{noise}",
            format_vector_mm(sensor.zero_mm),
            match sensor.mount {
                SensorMount::Spindle => "from the spindle datum",
                SensorMount::Table => "in the table frame",
                SensorMount::Bed => "in the machine frame",
            }
        );
        (format!("Sensor {}", sensor.name), text)
    };
    if plan.sensors.is_empty() {
        return stylus.into();
    }
    plan.sensors.iter().map(row).collect()
}

/// Number of steps of each kind.
fn describe_step_counts(plan: &Plan) -> String {
    let count = |kind, scan: Option<bool>| {
        let of_kind = plan.steps.iter().filter(|step| step.kind == kind);
        of_kind.filter(|step| scan.is_none_or(|scan| step.scan.is_some() == scan)).count()
    };
    let kinds = [
        (StepKind::Touch, None, "touches"),
        (StepKind::Reference, Some(false), "reference touches"),
        (StepKind::Scan, None, "scans"),
        (StepKind::Reference, Some(true), "reference scans"),
        (StepKind::Index, None, "index moves"),
        (StepKind::Prompt, None, "prompts"),
    ];
    let steps = kinds.map(|(kind, scan, name)| (count(kind, scan), name));
    let steps = steps.into_iter().filter(|(count, _)| *count > 0);
    steps.map(|(count, name)| format!("{name}: {count}")).collect::<Vec<_>>().join(", ")
}

fn describe_artefact(artefact: &Artefact) -> String {
    match artefact {
        Artefact::Cylinder(Cylinder { foot_mm: centre_mm, axis: [i, j, k], radius_mm, .. }) => {
            format!("cylinder, radius {radius_mm} mm, centre {}, axis ({i}, {j}, {k})", format_vector_mm(*centre_mm))
        }
        Artefact::Balls(artefact) => describe_balls(artefact),
        Artefact::DatumCylinder(artefact) => describe_datum_cylinder(artefact),
        Artefact::None => "none".to_owned(),
    }
}

fn describe_datum_cylinder(artefact: &DatumCylinder) -> String {
    let section = |section: &DatumCrossSection| format!("radius {} mm at {} mm", section.radius_mm, section.z_mm);
    let mut sections: Vec<String> = artefact.sections.iter().map(section).collect();
    sections.extend(artefact.face.iter().map(|face| format!("face at {} mm", face.z_mm)));
    format!("datum cylinder, foot {}; {}", format_vector_mm(artefact.foot_mm), sections.join(", "))
}

fn describe_balls(Balls { balls, lengths, .. }: &Balls) -> String {
    let radii = balls.iter().map(|ball| ball.radius_mm);
    let (least, most) = (radii.clone().fold(f64::INFINITY, f64::min), radii.fold(0.0, f64::max));
    let radius = match balls.len() {
        0 => String::new(),
        _ if least == most => format!(", radius {most} mm"),
        _ => format!(", radius {least} to {most} mm"),
    };
    let certified = lengths.iter().map(|length| {
        let u_um = 1e3 * length.u_mm;
        let u_um = number::format_fixed(u_um, number::decimals_for_uncertainty(u_um));
        format!("{} to {}: {} mm (u = {u_um} µm)", length.from, length.to, length.mm)
    });
    let certified: Vec<String> = certified.collect();
    let lengths = match certified.as_slice() {
        [] => "no certified length".to_owned(),
        some => format!("certified lengths {}", some.join(", ")),
    };
    let plural = if balls.len() == 1 { "" } else { "s" };
    format!("{} ball{plural}{radius}; {lengths}", balls.len())
}

fn format_vector_mm([x, y, z]: [f64; 3]) -> String {
    format!("({x}, {y}, {z}) mm")
}
