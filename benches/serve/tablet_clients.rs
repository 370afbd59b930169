//! Simulated tablets: each receives events and requests the live part of its page at each event, as the page's
//! script does. They run in a separate process at the lowest priority, because in a workshop they are other
//! computers.

use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;

use super::daemon::{EVENTS_PATH, LIVE_PATH};

const TABLET_TASK_VARIABLE: &str = "TRUED_BENCH_READERS";

pub struct TabletProcess(Child);

impl Drop for TabletProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl TabletProcess {
    pub fn new(address: &str, count: usize) -> Self {
        let mut command = Command::new("nice");
        command.args(["-n", "19"]).arg(std::env::current_exe().unwrap());
        command.env(TABLET_TASK_VARIABLE, format!("{address} {count}")).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut told = String::new();
        let out = child.stdout.as_mut().unwrap();
        std::io::BufRead::read_line(&mut std::io::BufReader::new(out), &mut told).unwrap();
        assert_eq!(told, "reading\n");
        Self(child)
    }
}

/// Address of the daemon and number of tablets, if this process is to run tablets instead of the benchmark.
pub fn tablet_task_from_environment() -> Option<(String, usize)> {
    let asked = std::env::var(TABLET_TASK_VARIABLE).ok()?;
    let (address, count) = asked.split_once(' ')?;
    Some((address.to_owned(), count.parse().ok()?))
}

/// Runs the tablets until the process is killed.
pub fn run_tablets(address: &str, count: usize) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let listening = Arc::new(AtomicU64::new(0));
        for _ in 0..count {
            tokio::spawn(run_tablet(address.to_owned(), Arc::clone(&listening)));
        }
        while listening.load(Ordering::Relaxed) < count as u64 {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        println!("reading");
        std::future::pending::<()>().await;
    });
}

async fn run_tablet(address: String, listening: Arc<AtomicU64>) {
    let mut events = TcpStream::connect(&address).await.unwrap();
    let head = |path: &str| format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n");
    events.write_all(head(EVENTS_PATH).as_bytes()).await.unwrap();
    let mut page = TcpStream::connect(&address).await.unwrap();
    let (mut lines, mut buffer) = (BufReader::new(events).lines(), vec![0; 64 * 1024]);
    listening.fetch_add(1, Ordering::Relaxed);
    while let Ok(Some(line)) = lines.next_line().await {
        if !line.starts_with("data:") {
            continue;
        }
        // The server closes an idle connection; a browser opens a new one.
        if page.write_all(head(LIVE_PATH).as_bytes()).await.is_err() || !receive_response(&mut page, &mut buffer).await
        {
            page = TcpStream::connect(&address).await.unwrap();
        }
    }
}

/// Reads a complete response, whose head gives the length; returns whether it was received.
async fn receive_response(page: &mut TcpStream, buffer: &mut [u8]) -> bool {
    let mut answer = Vec::new();
    loop {
        match page.read(buffer).await {
            Ok(count @ 1..) => answer.extend(&buffer[..count]),
            _ => return false,
        }
        let text = String::from_utf8_lossy(&answer);
        let Some((head, body)) = text.split_once("\r\n\r\n") else { continue };
        let length = head.lines().find_map(|line| line.strip_prefix("content-length: "));
        if length.and_then(|length| length.parse::<usize>().ok()).is_some_and(|all| body.len() >= all) {
            return true;
        }
    }
}
