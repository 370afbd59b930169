//! Controls that replay recorded answers at once: the time of a touch is then the time that the daemon takes.

use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::thread;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

use super::tape::{FULL_REPORT_REQUEST, GrblExchange, STATUS_REGISTER_COUNT, read_u16_be, take_modbus_frame};

/// Index of the heartbeat in the status block.
const STATUS_HEARTBEAT_INDEX: usize = 11;

/// Serves a grbl control on its own thread, on the stream that `open_stream` opens there.
pub fn serve_grbl_control<S: AsyncRead + AsyncWrite + Unpin>(
    tape: Vec<GrblExchange>,
    open_stream: impl FnOnce() -> S + Send + 'static,
) {
    thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let mut stream = open_stream();
            let (mut at, mut line, mut buffer) = (0, Vec::new(), [0; 4096]);
            stream.write_all(&tape[0].replies).await.unwrap();
            while let Ok(count @ 1..) = stream.read(&mut buffer).await {
                let mut said = Vec::new();
                for byte in &buffer[..count] {
                    match *byte {
                        b'?' if line.is_empty() => {
                            said.extend(&tape[at].report);
                            continue;
                        }
                        FULL_REPORT_REQUEST if line.is_empty() => {
                            said.extend(&tape[at].full_report);
                            continue;
                        }
                        byte => line.push(byte),
                    }
                    if *byte == b'\n' {
                        at += 1;
                        assert_eq!(std::mem::take(&mut line), tape[at].line);
                        said.extend(&tape[at].replies);
                    }
                }
                if stream.write_all(&said).await.is_err() {
                    return;
                }
            }
        });
    });
}

/// Serves a Modbus TCP control and returns its port. A chunk is complete as soon as its status is read.
pub fn serve_modbus_control(tape: BTreeMap<u16, Vec<u16>>) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        serve_modbus_stream(&tape, stream);
    });
    port
}

fn serve_modbus_stream(tape: &BTreeMap<u16, Vec<u16>>, mut stream: TcpStream) {
    stream.set_nodelay(true).unwrap();
    let (mut holding, mut status) = (vec![0_u16; 128], tape[&0].clone());
    let (mut bytes, mut buffer) = (Vec::new(), [0; 1024]);
    while let Ok(count @ 1..) = stream.read(&mut buffer) {
        bytes.extend(&buffer[..count]);
        while let Some(frame) = take_modbus_frame(&mut bytes) {
            let (function, address, many) = (frame[7], read_u16_be(&frame, 8), read_u16_be(&frame, 10));
            let (first, last) = (usize::from(address), usize::from(address + many));
            let registers = match function {
                16 => {
                    let values = frame[13..].chunks(2).map(|pair| read_u16_be(pair, 0));
                    holding[first..last].copy_from_slice(&values.collect::<Vec<_>>());
                    if let Some(done) = tape.get(&holding[1]).filter(|_| first == 1) {
                        status.clone_from(done);
                    }
                    Vec::new()
                }
                3 => holding[first..last].to_vec(),
                _ => {
                    assert_eq!((function, first, last), (4, 0, STATUS_REGISTER_COUNT));
                    status[STATUS_HEARTBEAT_INDEX] = status[STATUS_HEARTBEAT_INDEX].wrapping_add(1);
                    status.clone()
                }
            };
            let mut pdu = match function {
                16 => frame[7..12].to_vec(),
                _ => vec![function, 2 * registers.len() as u8],
            };
            pdu.extend(registers.iter().flat_map(|word| word.to_be_bytes()));
            let length = (pdu.len() as u16 + 1).to_be_bytes();
            let reply = [&frame[..4], &length, &frame[6..7], &pdu].concat();
            if stream.write_all(&reply).is_err() {
                return;
            }
        }
    }
}
