//! `trued run multiprobe` on a control without time stamps: C turns continuously, and an amplifier sends the count
//! of the encoder on C with each sample.

mod amplifier;

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::Output;
use std::sync::Arc;

use amplifier::{Amplifier, COUNTS_PER_TURN, ENCODER_COUNT_MODULUS, SENSOR_NAMES};
use machine::record::estimate::Estimate;

use crate::support::grbl_control::GrblControl;
use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::{MachineShop, stderr};
use crate::support::terminal_operator;

/// Error motions of `config/multiprobe.toml` 60 mm above the table, µm; all others are zero. At this height a tilt
/// of 1 µrad about Y displaces the axis by 0.06 µm along X, one about X by -0.06 µm along Y.
const TRUE_PARAMETERS: [(&str, f64); 10] = [
    ("EXC_c2", 1.2),
    ("EXC_s2", -0.4),
    ("EXC_c3", -2.0 * 0.06),
    ("EXC_s3", 4.0 * 0.06),
    ("EXC_c5", 0.3),
    ("EXC_s5", 0.2),
    ("EYC_c2", 3.0 * -0.06),
    ("EYC_s2", -2.0 * -0.06),
    ("EYC_c3", 0.6),
    ("EYC_s3", 0.8),
];
const HARMONIC_COUNT: usize = 6;
/// Tolerance of a coefficient, µm: gains and angles of the sensors are not known better.
const MAX_COEFFICIENT_ERROR_UM: f64 = 0.02;

pub fn trials() -> Trials {
    // The amplifier computes all samples of a turn before the control replies, which takes too long on busy cores.
    trials![Pool::Alone, 1;
        multiprobe_with_encoder_counts_finds_true_error_motions,
        reversed_encoder_counts_hold_the_run,
    ]
}

/// The keys that replace the line `simulated = ..` of the first sensors.
fn sensor_channel_keys(path: &str, column: usize) -> String {
    format!(
        "serial = {{ serial = \"{path}\", timeout_s = 5.0, line = {{ separator = \",\", columns = 5, \
         value = {{ column = {column}, scale_mm = 1.0, codes = [{{ is = \"OUT\", means = \"range\" }}] }}, \
         encoder_count = {{ column = 4, round = {ENCODER_COUNT_MODULUS} }}, \
         counter = {{ column = 5, round = 10000 }} }} }}"
    )
}

/// The machine of `config/multiprobe.toml` with one amplifier, one mounting, continuous turns.
fn encoder_machine_toml(control: SocketAddr, path: &str, counts_per_turn: i64) -> String {
    let mut file = include_str!("../../../config/multiprobe.toml").to_owned();
    for column in 1..=SENSOR_NAMES.len() {
        file = file.replacen("simulated = { rate_hz = 1000.0 }", &sensor_channel_keys(path, column), 1);
    }
    let changes = [
        ("kind = \"simulated\"\nwire = \"memory\"", format!("kind = \"grbl\"\ntcp = \"{control}\"")),
        ("indexes = 10", format!("indexes = 1\nsensors = {SENSOR_NAMES:?}\nmonte_carlo_trials = 100")),
        ("revolutions = 2", "revolutions = 1".to_owned()),
        ("positions = 90", "positions = 36".to_owned()),
        ("harmonics = 20", format!("harmonics = {HARMONIC_COUNT}")),
        ("sampling = \"dwell\"", "sampling = \"continuous\"".to_owned()),
        ("feed_deg_min = 1080.0", "feed_deg_min = 4320.0".to_owned()),
        ("samples = 4", "samples = 1".to_owned()),
        ("drift_um_per_h = 2.0", "drift_um_per_h = 0.1".to_owned()),
    ];
    for (from, to) in &changes {
        assert!(file.contains(from), "{from}");
        file = file.replacen(from, to, 1);
    }
    format!("{file}\n[encoder]\naxis = \"C\"\ncounts_per_turn = {counts_per_turn}\n")
}

/// Forwards bytes between client and control; bytes of the control are forwarded only after the amplifier has sent
/// its samples up to then.
fn start_proxy(control: SocketAddr, amplifier: Arc<Amplifier>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for client in listener.incoming() {
            let (client, control) = (client.unwrap(), TcpStream::connect(control).unwrap());
            let (from_client, to_control) = (client.try_clone().unwrap(), control.try_clone().unwrap());
            std::thread::spawn(move || forward_bytes(from_client, to_control, || ()));
            let amplifier = amplifier.clone();
            std::thread::spawn(move || forward_bytes(control, client, || amplifier.wait_until_due_samples_are_sent()));
        }
    });
    address
}

fn forward_bytes(mut from: TcpStream, mut to: TcpStream, before_forwarding: impl Fn()) -> io::Result<()> {
    use std::io::{Read as _, Write as _};
    to.set_nodelay(true)?;
    let mut buffer = [0; 1024];
    loop {
        let count = from.read(&mut buffer)?;
        if count == 0 {
            return to.shutdown(std::net::Shutdown::Write);
        }
        before_forwarding();
        to.write_all(&buffer[..count])?;
    }
}

/// A run on the machine whose file states `counts_per_turn`.
fn run_multiprobe(counts_per_turn: i64) -> (MachineShop, Output) {
    let anywhere: SocketAddr = ([127, 0, 0, 1], 9).into();
    let control = GrblControl::start(&encoder_machine_toml(anywhere, "/dev/null", counts_per_turn));
    let amplifier = Arc::new(Amplifier::start(control.world.clone()));
    let path = amplifier.port_path.clone();
    let address = start_proxy(control.address, amplifier);
    let shop = MachineShop::with_machine_file(&encoder_machine_toml(address, &path, counts_per_turn));
    let mut command = shop.trued_command(&["run", "multiprobe", "--json", "--machine", &shop.machine_path()]);
    let output = terminal_operator::confirm_prompts_with_enter(&mut command).output().unwrap();
    println!("{}", stderr(&output));
    (shop, output)
}

pub fn multiprobe_with_encoder_counts_finds_true_error_motions() {
    let (shop, output) = run_multiprobe(COUNTS_PER_TURN);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let estimate: Estimate = serde_json::from_slice(&output.stdout).unwrap();
    for motion in ["EXC", "EYC"] {
        for (part, order) in (2..=HARMONIC_COUNT).flat_map(|order| [("c", order), ("s", order)]) {
            let symbol = format!("{motion}_{part}{order}");
            let truth = TRUE_PARAMETERS.iter().find(|(of, _)| *of == symbol).map_or(0.0, |(_, um)| *um);
            let found = estimate.parameters.iter().find(|found| found.symbol == symbol);
            let value = found.unwrap().value;
            println!("{symbol} {value:.4}, truly {truth}");
            assert!((value - truth).abs() < MAX_COEFFICIENT_ERROR_UM, "{symbol} {value}, truly {truth}");
        }
    }
    assert_eq!(shop.run_states(), ["finished"]);
}

pub fn reversed_encoder_counts_hold_the_run() {
    let (shop, output) = run_multiprobe(-COUNTS_PER_TURN);
    let told = stderr(&output);
    for words in ["index/1", "a ratio of -1.0000", "write counts_per_turn = -90000 in [encoder]"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    assert_eq!(shop.run_states(), ["held"]);
}
