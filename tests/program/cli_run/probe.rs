//! The probe before and during a run: whether it responds, whether it is switched on, whether the clamps are
//! closed.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStderr, Command, Stdio};

use planning::gcode::Dialect;
use trued::setup::MachineFile;
use trued::setup::SimulationPace;

use super::recorded_grbl::RecordedGrbl;
use super::{MachineShop, machine_toml_with_control, simulated_machine_toml, stderr, toml_with_text_replacements};

fn shop_with_control(control: &RecordedGrbl, file: &str) -> MachineShop {
    let address = format!("kind = \"grbl\"\ntcp = \"{}\"", control.address);
    MachineShop::with_machine_file(&machine_toml_with_control(file, &address))
}

/// Starts a run and waits until it requests the deflection of the stylus.
fn start_run_until_deflection_request(shop: &MachineShop) -> (Child, BufReader<ChildStderr>) {
    let mut run = shop.self_calibration_command();
    let mut run = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut told = BufReader::new(run.stderr.take().unwrap());
    let mut line = String::new();
    while !line.starts_with("deflect the stylus by hand") {
        line.clear();
        assert_ne!(told.read_line(&mut line).unwrap(), 0, "ended before it asked");
    }
    (run, told)
}

fn machine_toml_with_manual_live_check() -> String {
    toml_with_text_replacements(
        &simulated_machine_toml(),
        &[("ball_radius_mm", "live_check = \"person\"\nball_radius_mm")],
    )
}

pub fn no_motion_before_the_stylus_was_deflected_by_hand() {
    let mut control = RecordedGrbl::start_at_pace(&simulated_machine_toml(), SimulationPace::Immediate);
    let shop = shop_with_control(&control, &machine_toml_with_manual_live_check());
    let (mut run, mut told) = start_run_until_deflection_request(&shop);
    control.wait_for_status_requests(20);
    assert!(!control.has_moved(), "moved before the stylus was deflected");
    control.world.lock().unwrap().set_stylus_deflected(true);
    control.wait_for_status_requests(20);
    assert!(!control.has_moved(), "moved while the stylus was deflected");
    control.world.lock().unwrap().set_stylus_deflected(false);
    let mut rest = String::new();
    told.read_to_string(&mut rest).unwrap();
    assert_eq!(run.wait().unwrap().code(), Some(0), "{rest}");
    assert!(rest.contains("the probe works\n"), "{rest}");
    assert_eq!(shop.run_states(), ["finished"]);
}

pub fn stop_while_waiting_for_stylus_deflection_holds_the_run() {
    let mut control = RecordedGrbl::start_at_pace(&simulated_machine_toml(), SimulationPace::Immediate);
    let shop = shop_with_control(&control, &machine_toml_with_manual_live_check());
    let (run, _told) = start_run_until_deflection_request(&shop);
    let kill = format!("kill -TERM {}", run.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    let ended = run.wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(5));
    assert!(!control.has_moved(), "moved without a live probe");
    assert_eq!(shop.run_states(), ["held"]);
}

pub fn missing_first_contact_names_a_dead_probe() {
    let far = toml_with_text_replacements(
        &simulated_machine_toml(),
        &[("centre_offset_mm", "centre_offset_mm = [-20.0, 0.0] #")],
    );
    // The first touch is on the flank.
    let far = far + "z_reference = false\n";
    let run = MachineShop::with_machine_file(&far).run_self_calibration();
    assert_eq!(run.status.code(), Some(5), "{}", stderr(&run));
    assert!(stderr(&run).contains("the first touch reached its end without contact"), "{}", stderr(&run));
    assert!(stderr(&run).contains("the probe may not work"), "{}", stderr(&run));
}

pub fn probe_and_clamps_are_switched_as_declared() {
    let clamp = "clamp = { close = \"M65 P3\", open = \"M64 P3\", wait_s = 0.1 }";
    let file = toml_with_text_replacements(
        &simulated_machine_toml(),
        &[
            ("ball_radius_mm", "on = \"M64 P1\"\noff = \"M65 P1\"\nsettle_s = 0.2\nball_radius_mm"),
            ("[axes.C]", &format!("[axes.C]\n{clamp}")),
        ],
    );
    let control = RecordedGrbl::start_at_pace(&simulated_machine_toml(), SimulationPace::Immediate);
    let shop = shop_with_control(&control, &file);
    let run = shop.run_self_calibration();
    assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    let (mut bytes, _) = control.wait_for_disconnect();
    // Status requests can occur between the bytes of lines.
    bytes.retain(|byte| !matches!(byte, b'?' | 0x87));
    let heard = String::from_utf8(bytes).unwrap();
    let program: Vec<&str> = heard.lines().filter(|line| !line.starts_with('$')).collect();
    let file = MachineFile::parse("machine.toml", file).unwrap();
    let dialect = Dialect::from_name("grbl").unwrap().with_machine_options(&file.machine, &file.probe).unwrap();
    // The reader rejects a probing move with the probe off or a clamp open, and a C move while the clamp is closed.
    let motions = dialect.read_back(&program.join("\n")).unwrap();
    assert!(motions.len() > 62 * 4, "{} motions", motions.len());
    let touches = shop.exported_reading_steps().len();
    assert_eq!(heard.matches("G4 P0.200").count(), touches, "a rest before each touch");
    let last = heard.rfind("G38").unwrap();
    assert!(heard[last..].contains("\nM65 P1\n"), "the probe stays on");
}

pub fn invalid_probe_switch_command_is_refused_before_a_run_exists() {
    let file = toml_with_text_replacements(
        &simulated_machine_toml(),
        &[("ball_radius_mm", "on = \"M3 S500\"\nball_radius_mm")],
    );
    let shop = MachineShop::with_machine_file(&file);
    let run = shop.run_self_calibration();
    assert_eq!(run.status.code(), Some(1), "{}", stderr(&run));
    assert!(stderr(&run).contains("[probe] on = \"M3 S500\""), "{}", stderr(&run));
    assert_eq!(shop.run_states(), [] as [String; 0]);
}
