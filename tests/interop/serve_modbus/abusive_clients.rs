//! Tests the Modbus server with clients that send malformed requests, too many requests, or none.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use super::modbus_client::{PymodbusClient, RUN_NUMBER_REGISTER, STATE_REGISTER};
use crate::support::machine_shop::{MODBUS_SECTION, MachineShop};

/// Reads all input registers as fast as possible.
fn flood_with_requests(mut stream: TcpStream, end: &AtomicBool, answers: &AtomicU32) {
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let mut answer = [0; 9 + 2 * 120];
    while !end.load(Ordering::Relaxed) {
        stream.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 100, 0, 120]).unwrap();
        stream.read_exact(&mut answer).unwrap();
        answers.fetch_add(1, Ordering::Relaxed);
    }
}

pub fn abusive_clients_do_not_change_the_result_of_a_cycle() {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    let machine = shop.machine_path();
    let calm = shop.run_json(&["run", "self-calibration", "--json", "--machine", &machine]);
    let daemon = shop.start_daemon("fast");
    let mut client = PymodbusClient::new(daemon.modbus_port());
    let exceptions = [
        ("discrete 0 1", 1),
        ("input 220 1", 2),
        ("input 200 30", 2),
        ("holding 1 1", 2),
        ("coil 19 1", 2),
        ("register 1 1", 2),
        ("registers 0 1 2", 2),
        ("coils 18 1 1", 2),
    ];
    for (request, code) in exceptions {
        assert_eq!(client.request(request), format!("exception {code}"), "{request}");
    }
    check_malformed_frames_rejected(daemon.modbus_port());
    assert!(!daemon.log().contains("panicked"));
    let (end, answers) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU32::new(0)));
    let floods: Vec<_> = (0..4)
        .map(|_| {
            let stream = TcpStream::connect(("127.0.0.1", daemon.modbus_port())).unwrap();
            let (end, answers) = (end.clone(), answers.clone());
            std::thread::spawn(move || flood_with_requests(stream, &end, &answers))
        })
        .collect();
    // Silent connections, incomplete requests, noise: more than there are connection slots.
    let address = SocketAddr::from(([127, 0, 0, 1], daemon.modbus_port()));
    let silent: Vec<TcpStream> = (0..30)
        .map(|number: u8| {
            let mut stream = TcpStream::connect(address).unwrap();
            let bytes: &[u8] = match number % 3 {
                0 => &[],
                1 => &[0, 1, 0, 0, 0, 6, 1],
                _ => &[0xff; 300],
            };
            let _ = stream.write_all(bytes);
            stream
        })
        .collect();
    client.set_enabling_inputs();
    client.press_coil(11);
    client.poll_status_until(|status| status[STATE_REGISTER] == 1 && status[RUN_NUMBER_REGISTER] == 2);
    end.store(true, Ordering::Relaxed);
    floods.into_iter().for_each(|flood| flood.join().unwrap());
    drop(silent);
    println!("{} requests answered beside the run", answers.load(Ordering::Relaxed));
    assert!(answers.load(Ordering::Relaxed) > 1000);
    let disturbed = shop.run_json(&["show", "2", "--json"]);
    let text = disturbed.to_string();
    for parameter in calm["parameters"].as_array().unwrap() {
        assert!(text.contains(&parameter["value"].to_string()), "{parameter} is not in {text}");
    }
}

/// Requests that pymodbus would not send, and the answer's function and exception code.
fn check_malformed_frames_rejected(port: u16) {
    let cases: [(&[u8], u8); 4] =
        [(&[4, 0, 0, 0, 0], 3), (&[4, 0, 0, 0, 126], 3), (&[0x55, 1, 2], 1), (&[1, 0, 0, 0, 0], 3)];
    for (pdu, code) in cases {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let mut frame = vec![0, 7, 0, 0, 0, pdu.len() as u8 + 1, 1];
        frame.extend_from_slice(pdu);
        stream.write_all(&frame).unwrap();
        let mut answer = [0; 9];
        stream.read_exact(&mut answer).unwrap();
        assert_eq!(answer[7..], [pdu[0] | 0x80, code], "{pdu:?}");
    }
    // More coils than bytes for them, at once or in pieces, more registers than bytes, a coil value that is neither
    // on nor off: the connection is closed without a log entry.
    let coils: &[u8] = &[0, 7, 0, 0, 0, 8, 1, 15, 0, 0, 0, 9, 1, 7];
    let registers: &[u8] = &[0, 7, 0, 0, 0, 9, 1, 16, 0, 0, 0, 2, 2, 0, 1];
    let half: &[u8] = &[0, 7, 0, 0, 0, 6, 1, 5, 0, 0, 0x12, 0];
    for (spoilt, pieces) in [(coils, 14), (coils, 5), (coils, 1), (registers, 15), (half, 12)] {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_nodelay(true).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        // A valid request comes first.
        stream.write_all(&[0, 6, 0, 0, 0, 8, 1, 15, 0, 0, 0, 8, 1, 0]).unwrap();
        stream.read_exact(&mut [0; 12]).unwrap();
        for piece in spoilt.chunks(pieces) {
            // The connection may be closed before the last piece.
            let _ = stream.write_all(piece);
        }
        assert!(!matches!(stream.read(&mut [0; 12]), Ok(1..)));
    }
}

pub fn clients_from_other_addresses_are_refused() {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    shop.replace_in_machine_file("allow = [\"127.0.0.1\"]", "allow = [\"127.0.0.2\"]");
    let daemon = shop.start_daemon("fast");
    let mut stranger = PymodbusClient::new(daemon.modbus_port());
    assert_eq!(stranger.request("input 0 1"), "lost");
    assert_eq!(stranger.request("coil 11 1"), "lost");
    let mut known = PymodbusClient::connect_from(daemon.modbus_port(), "127.0.0.2");
    assert_eq!(known.update_heartbeat_and_read_status()[STATE_REGISTER], 1);
    assert_eq!(known.request_registers("bits 11 1")[0], 0);
    assert!(daemon.log().contains("the connection from 127.0.0.1 is refused"));
}

/// A control that was switched off repeatedly: all connection slots are used, each with its last request answered,
/// none closed. The next connection still gets a slot, and an active client keeps its slot.
pub fn abandoned_connections_are_closed() {
    let shop = MachineShop::with_serve(MODBUS_SECTION);
    let daemon = shop.start_daemon("fast");
    let mut busy = PymodbusClient::new(daemon.modbus_port());
    let left: Vec<TcpStream> = (0..15)
        .map(|_| {
            let mut stream = TcpStream::connect(("127.0.0.1", daemon.modbus_port())).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
            stream.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 1]).unwrap();
            stream.read_exact(&mut [0; 11]).unwrap();
            stream
        })
        .collect();
    // All connections are recent: no slot is free.
    assert_eq!(busy.update_heartbeat_and_read_status()[STATE_REGISTER], 1);
    let mut early = TcpStream::connect(("127.0.0.1", daemon.modbus_port())).unwrap();
    early.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let _ = early.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 1]);
    match early.read(&mut [0; 12]) {
        Ok(0) => {}
        Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => {}
        other => panic!("{other:?}"),
    }
    for _ in 0..25 {
        std::thread::sleep(Duration::from_millis(100));
        assert_eq!(busy.update_heartbeat_and_read_status()[STATE_REGISTER], 1);
    }
    let mut next = PymodbusClient::new(daemon.modbus_port());
    assert_eq!(next.update_heartbeat_and_read_status()[STATE_REGISTER], 1);
    assert_eq!(busy.update_heartbeat_and_read_status()[STATE_REGISTER], 1);
    drop(left);
}
