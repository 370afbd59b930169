//! Targets of multiprobe's centring prompt: the artefact is moved in the simulated world by the values of the
//! prompt, and the sensors of that world are compared with the targets. The world computes distances from its own
//! surfaces.

use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, StepKind};
use machine::record::reading::Reading;
use methods::{IdentifyError, Method, MethodRefusal, NextStage, ObjectPositionSource};
use simulator::{SensorOutput, SimulatedWorld, Speed};
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use crate::support::plan_player;

/// Offset of the foot, mm, and tilt of the cylinder, with the table at zero.
const FOOT_OFFSET_MM: [f64; 2] = [0.090, -0.060];
const CYLINDER_TILT_URAD: [f64; 2] = [400.0, 300.0];
/// Heights of the sections of `config/multiprobe.toml` above the foot.
const SECTION_HEIGHTS_MM: [f64; 2] = [60.0, 120.0];
/// Number of samples of each sensor.
const SAMPLES_PER_SENSOR: usize = 20;

/// The first round of centring and the prompt after it, without a second round.
struct FirstCentringRoundMethod(Box<dyn Method>);

impl Method for FirstCentringRoundMethod {
    fn settings(&self) -> serde_json::Value {
        self.0.settings()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        if done.len() == 2 {
            return Ok(NextStage::NoFurtherStage);
        }
        let next = self.0.next_stage(plan, done, source)?;
        let NextStage::Stage { mut stage, mut new_steps } = next else { return Ok(next) };
        if done.len() == 1 {
            new_steps.retain(|step| step.kind == StepKind::Prompt);
            stage.steps = new_steps.iter().map(|step| step.id).collect();
        }
        Ok(NextStage::Stage { stage, new_steps })
    }

    fn identify(&self, _: &Plan, _: &[Reading]) -> Result<Estimate, IdentifyError> {
        Err(IdentifyError::IdentificationFailed("not needed".to_owned()))
    }
}

fn machine_with_artefact(offset_mm: [f64; 2], tilt_urad: [f64; 2]) -> MachineFile {
    let mut table: Table = include_str!("../../config/multiprobe.toml").parse().unwrap();
    let simulated = table["simulated"].as_table_mut().unwrap();
    simulated.insert("centre_offset_mm".to_owned(), Value::from(offset_mm.to_vec()));
    let cylinder = simulated["datum_cylinder"].as_table_mut().unwrap();
    cylinder.insert("tilt_urad".to_owned(), Value::from(tilt_urad.to_vec()));
    MachineFile::parse("world.toml", toml::to_string(&table).unwrap()).unwrap()
}

/// Displacements along X and Y that the prompt requests for each section, mm.
fn prompted_adjustment_mm(text: &str) -> [[f64; 2]; 2] {
    let number = |text: &str| text.split(" µm").next().unwrap().parse::<f64>().unwrap() * 1e-3;
    [1, 2].map(|section| {
        let rest = text.split(&format!("section {section} by X ")).nth(1).unwrap();
        [number(rest), number(rest.split(", Y ").nth(1).unwrap())]
    })
}

fn mean_sensor_distance_mm(world: &mut SimulatedWorld, sensor: &str) -> f64 {
    let mut sample = || match world.sample_after(sensor, 1e-3) {
        Some(SensorOutput::Distance(mm)) => mm,
        other => panic!("{sensor}: {other:?}"),
    };
    (0..SAMPLES_PER_SENSOR).map(|_| sample()).sum::<f64>() / SAMPLES_PER_SENSOR as f64
}

#[test]
fn sensors_read_their_targets_once_the_artefact_is_moved_as_the_prompt_says() {
    let file = machine_with_artefact(FOOT_OFFSET_MM, CYLINDER_TILT_URAD);
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "multiprobe", None).unwrap();
    let mut world = setup::build_world(&file).unwrap();
    let (plan, _) = plan_player::measure_all_stages(&mut world, &FirstCentringRoundMethod(method), header);
    let [.., turn, prompt] = plan.steps.as_slice() else { panic!("{:?}", plan.steps) };
    let told = prompted_adjustment_mm(prompt.text.as_deref().unwrap());
    // The table is at a whole revolution: its frame equals that of the machine, except for the form of the axis.
    for (section, z_mm) in SECTION_HEIGHTS_MM.into_iter().enumerate() {
        for k in [0, 1] {
            let truly = FOOT_OFFSET_MM[k] + CYLINDER_TILT_URAD[k] * 1e-6 * z_mm;
            assert!((told[section][k] + truly).abs() < 3e-3, "{told:?}, section {section}: {truly}");
        }
    }

    let [low_mm, high_mm] = SECTION_HEIGHTS_MM;
    let slope = [0, 1].map(|k| (told[1][k] - told[0][k]) / (high_mm - low_mm));
    let offset_mm = [0, 1].map(|k| FOOT_OFFSET_MM[k] + told[0][k] - slope[k] * low_mm);
    let tilt_urad = [0, 1].map(|k| CYLINDER_TILT_URAD[k] + slope[k] * 1e6);
    let mut centred = setup::build_world(&machine_with_artefact(offset_mm, tilt_urad)).unwrap();
    centred.travel(&turn.to, Speed::Rapid);
    assert_eq!(prompt.watch.len(), 7);
    for watched in &prompt.watch {
        let (name, before) = (watched.sensor.as_str(), mean_sensor_distance_mm(&mut world, &watched.sensor));
        let Some(target_mm) = watched.target_mm else {
            assert_eq!(name, "z1", "the face has no target");
            continue;
        };
        let off_um = (mean_sensor_distance_mm(&mut centred, name) - target_mm) * 1e3;
        println!("{name}: {:+.2} um from its target, {:+.1} before", off_um, (before - target_mm) * 1e3);
        assert!(off_um.abs() < 0.5, "{name}: {off_um} um from its target");
    }
}
