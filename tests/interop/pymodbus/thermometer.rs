//! pymodbus as a thermometer during a run: the readings contain the value of its register; a missing, silent or
//! invalid thermometer adds no value, and the run continues.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use link::modbus::Framing;
use machine::Position;
use machine::record::event::RunEvent;
use machine::record::reading::Reading;
use trued::setup::{self, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{EstimateSelection, Journal, NewRun, RunState};

use super::server::{PymodbusServer, block_on};

const SIMULATED_MACHINE_FILE: &str = include_str!("../../../config/simulated.toml");
const STALE_AFTER_S: f64 = 3.0;

/// The built-in machine with a thermometer at this server: tenths of a degree above -5 °C.
fn machine_with_thermometer(server: &PymodbusServer) -> MachineFile {
    let at = super::sensor::server_address_keys(server);
    let text = format!(
        "{SIMULATED_MACHINE_FILE}\n[[thermometer]]\nname = \"bed\"\nstale_s = {STALE_AFTER_S}\n[thermometer.modbus]\n{at}\n\
         unit = 1\ntimeout_s = 1.0\n\
         value = {{ register = 3, type = \"i16\", scale_c = 0.1, offset_c = -5.0 }}\n"
    );
    MachineFile::parse("machine.toml", text).unwrap()
}

/// Runs self-calibration on the simulated machine; `on_reading` is called with the number of each stored reading, from
/// 1. Returns the readings, the announced texts, and the mean temperatures by name.
async fn run_measurement(
    file: &MachineFile,
    mut on_reading: impl FnMut(usize),
) -> (Vec<Reading>, Vec<String>, BTreeMap<String, f64>) {
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::open(folder.path()).unwrap();
    let (method, header) = setup::configure_method_and_plan_without_steps(file, "self-calibration", Some(1)).unwrap();
    let devices = setup::open_devices(file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
    let new = NewRun { machine_file_text: file.text().to_owned(), plan: header.clone() };
    let id = journal.begin_run(&new).await.unwrap();
    let mut count = 0;
    let mut tell = |event: &RunEvent| {
        if matches!(event, RunEvent::ReadingStored { .. }) {
            count += 1;
            on_reading(count);
        }
    };
    let mut run = trued::run::Run::new(id, method.as_ref(), &devices, &journal, header, &mut tell);
    run.execute().await.unwrap();
    let (plan, readings) = (run.plan.clone(), run.readings.clone());
    let estimate = method.identify(&plan, &readings).unwrap();
    journal.add_estimate(id, &estimate).await.unwrap();
    let stored = journal.load_run(id).unwrap();
    assert_eq!((stored.summary.state, &stored.readings), (RunState::Finished, &readings));
    let told = stored.events.into_iter().filter_map(|(_, event)| match event {
        RunEvent::OperatorMessage { text } => Some(text),
        _ => None,
    });
    let mut measured = None;
    journal
        .visit_finished_run_results(&file.machine.name, 1, EstimateSelection::Last, |it| measured = Some(it))
        .unwrap();
    let measured = measured.unwrap();
    (readings, told.collect(), measured.temperatures_c.into())
}

fn bed_temperature_c(reading: &Reading) -> Option<f64> {
    reading.temperatures_c.get("bed")
}

/// Waits until the independently polled thermometer has a new value or is stale.
fn sleep_past_stale_limit() {
    std::thread::sleep(Duration::from_secs_f64(1.5 * STALE_AFTER_S));
}

async fn check_temperatures_stored(framing: Framing) -> Result<(), Failed> {
    let mut server = PymodbusServer::start(framing);
    server.set_register_value(262);
    let file = machine_with_thermometer(&server);
    let (readings, told, means) = run_measurement(&file, |count| {
        if count == 30 {
            server.set_register_value(274);
            sleep_past_stale_limit();
        }
    })
    .await;
    // 26.2 - 5.0 and 27.4 - 5.0.
    for (number, reading) in readings.iter().enumerate() {
        let expected = if number < 30 { 21.2 } else { 22.4 };
        let said = bed_temperature_c(reading).ok_or_else(|| format!("reading {number} has none"))?;
        assert!((said - expected).abs() < 1e-9, "reading {number}: {said}");
    }
    let all: Vec<f64> = readings.iter().filter_map(bed_temperature_c).collect();
    assert!((means["bed"] - all.iter().sum::<f64>() / all.len() as f64).abs() < 1e-9, "{means:?}");
    assert!(means.contains_key("spindle") && readings.len() > 60, "{means:?} {}", readings.len());
    assert!(told.iter().all(|text| !text.contains("thermometer")), "{told:?}");
    Ok(())
}

pub fn readings_contain_the_temperature_over_tcp() -> Result<(), Failed> {
    block_on(check_temperatures_stored(Framing::Tcp))
}

pub fn readings_contain_the_temperature_over_rtu() -> Result<(), Failed> {
    block_on(check_temperatures_stored(Framing::Rtu))
}

/// Silent, invalid, and valid again: reported once, and no reading has an outdated value.
pub fn readings_have_no_temperature_while_the_thermometer_is_lost() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Tcp);
        server.set_register_value(262);
        let file = machine_with_thermometer(&server);
        let (readings, told, means) = run_measurement(&file, |count| match count {
            20 => {
                server.set_faults(&["drop"; 500]);
                sleep_past_stale_limit();
                sleep_past_stale_limit();
            }
            // 850 °C.
            30 => {
                server.set_faults(&[]);
                server.set_register_value(8550);
                sleep_past_stale_limit();
            }
            40 => {
                server.set_register_value(300);
                sleep_past_stale_limit();
            }
            _ => {}
        })
        .await;
        let numbers = |from: usize, to: usize| readings[from..to].iter().map(bed_temperature_c);
        assert!(numbers(0, 20).all(|said| said.is_some_and(|c| (c - 21.2).abs() < 1e-9)));
        assert!(numbers(20, 40).all(|said| said.is_none()));
        let rest = readings.len() - 40;
        assert!(numbers(40, 40 + rest).all(|said| said.is_some_and(|c| (c - 25.0).abs() < 1e-9)));
        let mean = (20.0 * 21.2 + rest as f64 * 25.0) / (20 + rest) as f64;
        assert!((means["bed"] - mean).abs() < 1e-9, "{means:?} {mean}");
        let away: Vec<_> = told.iter().filter(|text| text.contains("thermometer bed")).collect();
        let [once, end] = away[..] else { panic!("{told:?}") };
        assert!(once.contains("does not reply: ") && once.contains("no reply within"), "{once}");
        let counted = format!("20 of {} readings have no temperature", readings.len());
        assert!(end.contains(&counted), "{end}");
        Ok(())
    })
}

/// A thermometer that never answers delays no touch: the readings equal those of a run without it.
pub fn silent_thermometer_changes_no_touch() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Tcp);
        server.set_faults(&["drop"; 2000]);
        let file = machine_with_thermometer(&server);
        let (readings, told, means) = run_measurement(&file, |_| {}).await;
        assert!(readings.iter().all(|reading| bed_temperature_c(reading).is_none()));
        assert_eq!(means.keys().collect::<Vec<_>>(), ["spindle"]);
        assert_eq!(told.iter().filter(|text| text.contains("does not reply")).count(), 1, "{told:?}");
        let plain = MachineFile::parse("machine.toml", SIMULATED_MACHINE_FILE.to_owned()).unwrap();
        let (without, ..) = run_measurement(&plain, |_| {}).await;
        let places = |all: &[Reading]| -> Vec<(u32, Position)> {
            all.iter().map(|reading| (reading.step, reading.position.clone())).collect()
        };
        assert_eq!(places(&readings), places(&without));
        Ok(())
    })
}

/// Result of `trued check` for a register of pymodbus.
pub fn thermometer_read_gives_the_value_or_its_error() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Tcp);
        server.set_register_value(262);
        let file = machine_with_thermometer(&server);
        let devices = setup::open_devices(&file, SimulationPace::Immediate, EarlierSessions::default()).await?;
        let began = Instant::now();
        let mut said = Vec::new();
        for (value, faults) in [(262, ""), (8550, ""), (262, "drop"), (262, "exception:2")] {
            server.set_register_value(value);
            server.set_faults(&[faults]);
            let all = devices.thermometers.read_once().await;
            let (entry, answer) = all.into_iter().find(|(entry, _)| entry.name == "bed").unwrap();
            said.push(match answer {
                Ok(celsius) => format!("{} {celsius:.1}", entry.name),
                Err(error) => format!("{error}; {}", error.remedy()),
            });
        }
        let wanted = ["bed 21.2", "850.0 °C", "no reply within", "many manuals count registers from"];
        for (said, words) in said.iter().zip(wanted) {
            assert!(said.contains(words), "{words}: {said}");
        }
        println!("{:.1} s", began.elapsed().as_secs_f64());
        Ok(())
    })
}
