//! A line of text, here over TCP, as a serial server carries it.

use crate::support::machine_shop::MachineShop;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::thread::sleep;
use std::time::{Duration, Instant};

pub fn line_protocol_starts_a_cycle() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let shop = MachineShop::with_serve(&format!("[serve.line]\ntcp = \"127.0.0.1:{port}\"\n"));
    let daemon = shop.start_daemon("fast");
    let (mut line, _) = listener.accept().unwrap();
    line.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut answers = BufReader::new(line.try_clone().unwrap());
    let mut ask = |words: &str| {
        line.write_all(format!("{words}\r\n").as_bytes()).unwrap();
        let mut answer = String::new();
        answers.read_line(&mut answer).unwrap();
        answer.trim().to_owned()
    };
    let refused = "REFUSED the external start is not enabled at the machine";
    assert_eq!(ask("START 1"), refused);
    assert_eq!(ask("START 1 ENABLE AUTO"), "REFUSED a guard is open");
    assert_eq!(ask("START 2 ENABLE AUTO DOOR"), "REFUSED the configuration does not contain this cycle");
    assert_eq!(ask("START 1 ENABLE AUTO DOOR NOW"), "REFUSED the line is not a valid command");
    assert_eq!(ask("start 1 enable auto door"), "OK run 1");
    assert_eq!(ask("START 1 ENABLE AUTO DOOR"), "REFUSED a run is in progress");
    let started = Instant::now();
    while !ask("STATE").starts_with("WAITING cycle 1 run 1 100 %") {
        assert!(started.elapsed() < Duration::from_secs(60));
        sleep(Duration::from_millis(50));
    }
    assert_eq!(daemon.terminate(), 0);
    assert_eq!(shop.run_states(), ["finished"]);
}
