//! The same simulated machine on different wires.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use link::LinkAddress;

use super::{
    MachineShop, estimate_without_provenance, machine_toml_with_control, simulated_machine_toml, stderr,
    successful_json_output, toml_with_text_replacements,
};

/// `trued simulate`, ended with the test.
struct SimulatorProcess {
    process: Child,
    port_path: String,
}

impl SimulatorProcess {
    fn start(shop: &MachineShop) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_trued"))
            .args(["simulate", "--machine", &shop.path_text("machine.toml")])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut path = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut path).unwrap();
        Self { process, port_path: path.trim().to_owned() }
    }

    fn client_shop(&self) -> MachineShop {
        MachineShop::with_machine_file(&machine_toml_with_control(
            &simulated_machine_toml(),
            &format!("kind = \"grbl\"\nserial = \"{}\"", self.port_path),
        ))
    }
}

impl Drop for SimulatorProcess {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

pub fn memory_pty_and_another_process_give_the_same_result() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let memory = shop.run_self_calibration();
    assert!(successful_json_output(&memory)["parameters"].is_array());

    let pty = MachineShop::with_machine_file(&toml_with_text_replacements(
        &simulated_machine_toml(),
        &[("wire = \"memory\"", "wire = \"pty\"")],
    ))
    .run_self_calibration();
    assert_eq!(pty.status.code(), Some(0), "{}", stderr(&pty));
    assert!(pty.stdout == memory.stdout, "a pty in this process gives something else");

    let simulator = SimulatorProcess::start(&shop);
    let process = simulator.client_shop().run_self_calibration();
    assert!(
        estimate_without_provenance(&process) == estimate_without_provenance(&memory),
        "a simulator of its own gives something else"
    );
}

pub fn a_busy_port_is_reported_and_leaves_no_run() {
    let simulator = SimulatorProcess::start(&MachineShop::with_machine_file(&simulated_machine_toml()));
    let client = simulator.client_shop();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let address = LinkAddress::Serial { path: simulator.port_path.clone(), baud: 115_200 };
    let holder = runtime.block_on(link::open_line_link(&address)).unwrap();

    let refused = client.run_self_calibration();
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    let busy = format!("{} is in use by another program", simulator.port_path);
    assert!(stderr(&refused).contains(&busy), "{}", stderr(&refused));
    assert_eq!(client.run_states(), [] as [String; 0]);
    drop(holder);
}
