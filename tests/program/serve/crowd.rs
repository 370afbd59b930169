//! A thousand connections at once: silent ones, slow heads, slow bodies, clients that read nothing, event
//! listeners. They run in other processes: this one may have too few file descriptors, and must not be measured
//! with them.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::sleep;

use super::hostile_requests::{GuardedDaemon, bearer_header};
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{MACHINE_API_PATH, start_request_body};

const CLIENT_PROCESS_VARIABLE: &str = "TRUED_TEST_CROWD";
const CONNECTING_PROCESS_VARIABLE: &str = "TRUED_TEST_CONNECTS";
const CLIENT_PROCESS_COUNT: usize = 2;
const CLIENTS_PER_PROCESS: usize = 500;
/// Maximum additional memory of the daemon, KiB: the limits of docs/page.md, with a margin.
const MAX_MEMORY_GROWTH_KIB: u64 = 32 * 1024;

/// Port and token for a child process that acts as the crowd.
pub fn crowd_port_and_token() -> Option<(u16, String)> {
    let asked = std::env::var(CLIENT_PROCESS_VARIABLE).ok()?;
    let (port, token) = asked.split_once(' ')?;
    Some((port.parse().ok()?, token.to_owned()))
}

/// Runs the crowd until the process is killed; prints a line once all clients have been connected.
pub fn run_client_crowd(port: u16, token: &str) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (tell, mut told) = tokio::sync::mpsc::channel(CLIENTS_PER_PROCESS);
        for number in 0..CLIENTS_PER_PROCESS {
            tokio::spawn(run_misbehaving_client(port, token.to_owned(), number, tell.clone()));
        }
        for _ in 0..CLIENTS_PER_PROCESS {
            told.recv().await.unwrap();
        }
        println!("crowded");
        sleep(Duration::from_secs(3600)).await;
    });
}

/// Port, and source address, for a child process that only connects.
pub fn connecting_process_port_and_source() -> Option<(u16, Ipv4Addr)> {
    let asked = std::env::var(CONNECTING_PROCESS_VARIABLE).ok()?;
    let (port, from) = asked.split_once(' ')?;
    Some((port.parse().ok()?, from.parse().ok()?))
}

/// Connects as fast as possible until the process is killed; sends nothing.
pub fn open_idle_connections_until_killed(port: u16, from: Ipv4Addr) {
    const KEPT_CONNECTION_COUNT: usize = 200;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut kept = VecDeque::new();
        println!("crowded");
        loop {
            let socket = TcpSocket::new_v4().unwrap();
            socket.set_zero_linger().unwrap();
            let connected = match socket.bind(SocketAddr::from((from, 0))) {
                Ok(()) => socket.connect(SocketAddr::from(([127, 0, 0, 1], port))).await,
                Err(error) => Err(error),
            };
            match connected {
                Ok(stream) => kept.push_back(stream),
                Err(_) => sleep(Duration::from_millis(1)).await,
            }
            kept.drain(..kept.len().saturating_sub(KEPT_CONNECTION_COUNT));
        }
    });
}

/// One client; it reconnects whenever it is disconnected.
async fn run_misbehaving_client(port: u16, token: String, number: usize, tell: tokio::sync::mpsc::Sender<()>) {
    let mut first = Some(tell);
    loop {
        if let Ok(stream) = TcpStream::connect(("127.0.0.1", port)).await {
            if let Some(tell) = first.take() {
                tell.send(()).await.unwrap();
            }
            // Any end of the connection is accepted.
            let _ = send_misbehaving_request(stream, port, &token, number % 6).await;
        }
        sleep(Duration::from_secs(3)).await;
    }
}

async fn send_misbehaving_request(mut stream: TcpStream, port: u16, token: &str, kind: usize) -> std::io::Result<()> {
    let host = format!("Host: localhost:{port}\r\nAuthorization: Bearer {token}\r\n");
    let mut answer = [0; 4096];
    match kind {
        0 => {}
        1 => stream.write_all(format!("GET / HTTP/1.1\r\n{host}X-Half: ").as_bytes()).await?,
        2 => {
            for byte in format!("GET /runs HTTP/1.1\r\n{host}X-Slow: {}", "s".repeat(10_000)).bytes() {
                stream.write_all(&[byte]).await?;
                sleep(Duration::from_millis(200)).await;
            }
        }
        3 => {
            let head = "Content-Type: application/json\r\nContent-Length: 10000\r\n\r\n";
            let head = format!("POST {MACHINE_API_PATH}/acknowledge HTTP/1.1\r\n{host}{head}");
            stream.write_all(head.as_bytes()).await?;
            for _ in 0..10_000 {
                stream.write_all(b" ").await?;
                sleep(Duration::from_millis(200)).await;
            }
        }
        // Sends requests continuously and reads no response.
        4 => {
            let request = format!("GET /runs/1 HTTP/1.1\r\n{host}\r\n").repeat(20);
            stream.write_all(request.as_bytes()).await?;
            sleep(Duration::from_secs(60)).await;
        }
        _ => {
            let request = format!("GET {MACHINE_API_PATH}/events HTTP/1.1\r\n{host}\r\n");
            stream.write_all(request.as_bytes()).await?;
        }
    }
    while stream.read(&mut answer).await? > 0 {}
    Ok(())
}

/// A child process, killed when dropped.
struct ClientProcess(Child);

impl Drop for ClientProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl ClientProcess {
    fn start_crowd(guarded: &GuardedDaemon) -> Self {
        Self::start_with_variable(CLIENT_PROCESS_VARIABLE, &format!("{} {}", guarded.port, guarded.metrologist_token))
    }

    fn start_with_variable(variable: &str, value: &str) -> Self {
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -n 4096 2>/dev/null; exec \"$0\""]);
        command.arg(std::env::current_exe().unwrap()).env(variable, value);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut told = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut told).unwrap();
        assert_eq!(told, "crowded\n");
        Self(child)
    }
}

/// Peak memory of the daemon, KiB.
fn peak_memory_kib(daemon: &DaemonProcess) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", daemon.child.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().strip_suffix(" kB").unwrap().parse().unwrap()
}

/// Starts a run; returns its parameters after it has ended.
fn parameters_of_next_run(guarded: &GuardedDaemon) -> Value {
    let before = guarded.machine_state()["run"].as_u64().unwrap();
    assert_eq!(guarded.post_status("start", &guarded.operator_token, &start_request_body()), 202);
    let ended = |now: &Value| now["state"] == "waiting" && now["run"].as_u64().unwrap() > before;
    guarded.wait_until(ended)["parameters"].clone()
}

pub fn many_clients_change_no_result_and_memory_growth_is_limited() {
    let guarded = GuardedDaemon::new("fast");
    let wanted = parameters_of_next_run(&guarded);
    let calm_kib = peak_memory_kib(&guarded.daemon);
    let crowds: Vec<ClientProcess> = (0..CLIENT_PROCESS_COUNT).map(|_| ClientProcess::start_crowd(&guarded)).collect();
    // The results with the crowd equal those without it, to the last digit.
    assert_eq!(parameters_of_next_run(&guarded), wanted);
    assert!(wanted.as_array().unwrap().len() > 5);
    let crowd_kib = peak_memory_kib(&guarded.daemon);
    println!("memory: {calm_kib} KiB at most without a crowd, {crowd_kib} KiB with it");
    assert!(crowd_kib < calm_kib + MAX_MEMORY_GROWTH_KIB, "{calm_kib} KiB, with a crowd {crowd_kib} KiB");
    drop(crowds);
    assert!(!guarded.daemon.log().contains("panicked"));
}

/// A hold works in spite of the crowd.
pub fn hold_works_with_many_clients() {
    let guarded = GuardedDaemon::new("real");
    let _crowds: Vec<ClientProcess> = (0..CLIENT_PROCESS_COUNT).map(|_| ClientProcess::start_crowd(&guarded)).collect();
    assert_eq!(guarded.post_status("start", &guarded.operator_token, &start_request_body()), 202);
    // During the approach of the first step, which takes half a minute: the machine moves.
    guarded.wait_until(|now| now["step"] != "");
    assert_eq!(guarded.post_status("hold", &guarded.viewer_token, &json!({})), 202);
    guarded.wait_until(|now| now["state"] == "held");
    assert_eq!(guarded.shop.run_states(), ["held"]);
}

/// Three processes that only connect, continuously, from other addresses: no hold is lost.
pub fn repeated_idle_connections_block_no_hold() {
    let guarded = GuardedDaemon::new("fast");
    let crowds = [2, 3, 4].map(|last| {
        ClientProcess::start_with_variable(
            CONNECTING_PROCESS_VARIABLE,
            &format!("{} {}", guarded.port, Ipv4Addr::new(127, 0, 0, last)),
        )
    });
    std::thread::sleep(Duration::from_secs(1));
    for _ in 0..300 {
        assert_eq!(guarded.post_status("hold", &guarded.viewer_token, &json!({})), 202);
    }
    drop(crowds);
}

/// The 65th listener of one caller replaces the oldest of the same caller.
pub fn event_streams_are_limited() {
    let guarded = GuardedDaemon::new("fast");
    let listen = |token: &str| {
        let mut stream = std::net::TcpStream::connect(("127.0.0.1", guarded.port)).unwrap();
        let host = format!("Host: localhost:{}\r\n", guarded.port);
        let request = format!("GET {MACHINE_API_PATH}/events HTTP/1.1\r\n{host}{}\r\n", bearer_header(token));
        stream.write_all(request.as_bytes()).unwrap();
        // The head, and with it the first event.
        assert!(stream.read(&mut [0; 4096]).unwrap() > 0);
        stream
    };
    let mut tablet = listen(&guarded.viewer_token);
    let mut crowd: Vec<_> = (0..70).map(|_| listen(&guarded.operator_token)).collect();
    let mut gone = 0;
    let is_closed = |stream: &mut std::net::TcpStream| {
        stream.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        loop {
            match stream.read(&mut [0; 4096]) {
                Ok(0) => return true,
                Ok(_) => {}
                Err(error) => return error.kind() != ErrorKind::WouldBlock,
            }
        }
    };
    // The task of a closed connection ends some time later.
    for _ in 0..100 {
        let closed = crowd.extract_if(.., |stream| is_closed(stream)).count();
        gone += closed;
        if gone >= 7 {
            break;
        }
    }
    assert_eq!(gone, 7);
    assert!(!is_closed(&mut tablet), "the tablet");
}
