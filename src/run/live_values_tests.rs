//! Tests of sensors that are read while a run waits for the operator. One sensor is a TCP sender with several kinds of
//! failure.

use std::io::Write as _;
use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::live_values::live_values_with_artefact_position;
use super::*;
use crate::setup::{self, EarlierSessions, MachineFile, SimulationPace};
use crate::store::NewRun;
use machine::record::watched_sensors::{CrossSectionPoint, LiveSensorValue, LiveValues, WatchedSensor};

/// Behaviour of the sender.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SensorSignal {
    Distance,
    NoEcho,
    Silent,
    ConnectionClosed,
}

/// Sends a hundred lines per second until it closes the connection.
fn start_tcp_sensor(signal: Arc<Mutex<SensorSignal>>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        loop {
            let line: &[u8] = match *signal.lock().unwrap() {
                SensorSignal::Distance => b"M0,+0.04000\r\n",
                SensorSignal::NoEcho => b"M0,-FFFFFFF\r\n",
                SensorSignal::Silent => b"",
                SensorSignal::ConnectionClosed => return,
            };
            if stream.write_all(line).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    });
    address
}

/// The built-in machine with its first sensor on a TCP port.
fn machine_with_sensor(address: SocketAddr) -> MachineFile {
    let built_in = MachineFile::built_in_for_method("multiprobe").unwrap();
    let serial = format!(
        "[sensor.serial]\ntcp = \"{address}\"\ntimeout_s = 0.3\n[sensor.serial.line]\nend = \"\\r\\n\"\n\
         separator = \",\"\ncolumns = 2\n\
         value = {{ column = 2, scale_mm = 1.0, codes = [{{ is = \"-FFFFFFF\", means = \"no-echo\" }}] }}\n"
    );
    let simulated = "simulated = { rate_hz = 1000.0 }\n";
    MachineFile::parse("shop.toml", built_in.text().replacen(simulated, &serial, 1)).unwrap()
}

/// The signal that the live value results from, and the signal to send next.
fn received_and_next_signal(x1: &LiveSensorValue) -> Option<(SensorSignal, SensorSignal)> {
    match (x1.value_mm, x1.failure.as_deref()) {
        (Some(0.04), None) => Some((SensorSignal::Distance, SensorSignal::NoEcho)),
        (None, Some("out of range")) => Some((SensorSignal::NoEcho, SensorSignal::Silent)),
        (None, Some("no signal")) => Some((SensorSignal::Silent, SensorSignal::ConnectionClosed)),
        (None, Some(_)) => Some((SensorSignal::ConnectionClosed, SensorSignal::ConnectionClosed)),
        _ => None,
    }
}

/// The operator moves the sensor while the run waits. Every state is shown, nothing is stored, and only the
/// answer ends the wait. After the answer no sensor is read for display.
#[tokio::test]
async fn sensor_failures_are_shown_and_do_not_end_a_prompt() {
    let signal = Arc::new(Mutex::new(SensorSignal::Distance));
    let file = machine_with_sensor(start_tcp_sensor(signal.clone()));
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::open(folder.path()).unwrap();
    let (method, plan_without_steps) =
        setup::configure_method_and_plan_without_steps(&file, "multiprobe", None).unwrap();
    let new = NewRun { machine_file_text: file.text().to_owned(), plan: plan_without_steps.clone() };
    let id = journal.begin_run(&new).await.unwrap();
    let devices = setup::open_devices(&file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();

    let (mut told, mut kept, mut seen) = (Vec::<LiveValues>::new(), Vec::new(), Vec::new());
    let (is_done, is_answered) = (Arc::new(AtomicBool::new(false)), AtomicBool::new(false));
    let mut on_event = |event: &RunEvent| match event {
        RunEvent::Watched { values } => {
            assert!(!is_answered.load(Ordering::SeqCst), "read after the answer");
            if let Some((is, next)) = received_and_next_signal(&values.sensors[0]) {
                *signal.lock().unwrap() = next;
                is_done.store(is == SensorSignal::ConnectionClosed, Ordering::SeqCst);
                seen.extend((seen.last() != Some(&is)).then_some(is));
            }
            kept.push(journal.load_run(id).unwrap().events.len());
            told.push(values.clone());
        }
        RunEvent::PromptConfirmed { .. } => is_answered.store(true, Ordering::SeqCst),
        _ => {}
    };
    let answers = {
        let is_done = is_done.clone();
        PromptAnswerSource::new(move |_| is_done.load(Ordering::SeqCst).then(|| "Ada".to_owned()))
    };
    let run = Run::new(id, method.as_ref(), &devices, &journal, plan_without_steps, &mut on_event);
    let ended = run.with_prompt_answer_source(answers).execute().await;

    assert_eq!(
        seen,
        [SensorSignal::Distance, SensorSignal::NoEcho, SensorSignal::Silent, SensorSignal::ConnectionClosed]
    );
    assert!(kept.windows(2).all(|pair| pair[0] == pair[1]), "the journal has grown: {kept:?}");
    // After the answer the run fails, because the turn needs the failed sensor.
    let failed = ended.unwrap_err();
    assert!(!failed.is_requested_stop() && failed.to_string().contains("x1"), "{failed}");
    let stored = journal.load_run(id).unwrap();
    assert!(stored.readings.is_empty());
    let asked = stored.events.iter().filter(|(_, event)| matches!(event, RunEvent::Watched { .. }));
    assert_eq!(asked.count(), 0);
    for LiveValues { sensors, sections, tilt_urad } in &told {
        assert_eq!((sensors.len(), sections.len(), *tilt_urad), (7, 0, None));
        // The other sensors continue to measure; each has the middle of its range as target.
        assert!(sensors[1..].iter().all(|live| live.value_mm.is_some_and(|mm| mm.abs() < 0.3)));
        assert!(sensors.iter().all(|live| live.target_mm == Some(0.0)));
    }
}

/// Distance from a sensor outside a circle of 30 mm radius to the circle, along the line through the origin.
fn distance_to_circle_mm(angle_rad: f64, [x, y]: [f64; 2]) -> f64 {
    let (sin, cos) = angle_rad.sin_cos();
    let (along, across) = (x * cos + y * sin, y * cos - x * sin);
    40.0 - along - (30.0_f64.powi(2) - across * across).sqrt()
}

/// Sections with the distances to the centred circle as targets.
fn watched_circle_sensors(
    sections_mm: &[(f64, [f64; 2])],
    angles_deg: &[f64],
) -> Vec<(WatchedSensor, LiveSensorValue)> {
    let numbered = (1..).zip(sections_mm);
    let all = numbered.flat_map(|section| angles_deg.iter().map(move |angle| (section, *angle)));
    let one = |((number, (z_mm, at)), angle_deg): ((usize, &(f64, [f64; 2])), f64)| {
        let target_mm = Some(distance_to_circle_mm(angle_deg.to_radians(), [0.0; 2]));
        let section = Some(CrossSectionPoint { number, z_mm: *z_mm, angle_deg });
        let sensor = format!("{number}/{angle_deg}");
        let (range_mm, failure) = ([9.0, 11.0], None);
        let value_mm = Some(distance_to_circle_mm(angle_deg.to_radians(), *at));
        let live = LiveSensorValue { sensor: sensor.clone(), range_mm, target_mm, value_mm, failure };
        (WatchedSensor { sensor, target_mm, section }, live)
    };
    all.map(one).collect()
}

#[test]
fn eccentricity_and_tilt_agree_with_displaced_circles() {
    let truth = [(60.0, [0.020, -0.035]), (120.0, [0.050, -0.005])];
    for angles_deg in [&[0.0, 90.0, 230.0][..], &[10.0, 95.0]] {
        let (watch, live): (Vec<_>, Vec<_>) = watched_circle_sensors(&truth, angles_deg).into_iter().unzip();
        let LiveValues { sections, tilt_urad, .. } = live_values_with_artefact_position(&watch, live);
        for (section, (_, truly_mm)) in sections.iter().zip(truth) {
            let found = section.eccentricity_um.unwrap();
            let off = [0, 1].map(|k| (found[k] - truly_mm[k] * 1e3).abs());
            assert!(off.iter().all(|off| *off < 0.1), "{found:?}, truly {truly_mm:?}");
        }
        let tilt = tilt_urad.unwrap();
        assert!(tilt.iter().all(|slope| (slope - 500.0).abs() < 2.0), "{tilt:?}");
    }
}

#[test]
fn section_with_two_opposite_sensors_has_no_eccentricity() {
    let truth = [(60.0, [0.020, -0.035]), (120.0, [0.050, -0.005])];
    let (watch, mut live): (Vec<_>, Vec<_>) = watched_circle_sensors(&truth, &[0.0, 90.0, 180.0]).into_iter().unzip();
    // Two opposite sensors remain in the second section.
    live[4].value_mm = None;
    let LiveValues { sections, tilt_urad, .. } = live_values_with_artefact_position(&watch, live);
    assert!(sections[0].eccentricity_um.is_some());
    assert_eq!((sections[1].eccentricity_um, tilt_urad), (None, None));
}
