//! A thousand connections at once: silent ones, slow heads, slow bodies, readers who take nothing, listeners.
//! They are other processes: this one may have too few files, and is not to be measured with them.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::sleep;

use super::hostile::Guarded;
use super::page::{MACHINE, vouched};
use super::shop::Daemon;

const ASKED: &str = "TRUED_TEST_CROWD";
const CROWDS: usize = 2;
const EACH: usize = 500;
/// A crowd may cost the daemon so much memory, KiB: the bounds of docs/page.md, and room.
const MOST_KIB: u64 = 32 * 1024;

/// The port that this process is to crowd, and the token that it has.
pub fn asked_for() -> Option<(u16, String)> {
    let asked = std::env::var(ASKED).ok()?;
    let (port, token) = asked.split_once(' ')?;
    Some((port.parse().ok()?, token.to_owned()))
}

/// Until it is killed; says so once each has been connected.
pub fn be(port: u16, token: &str) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (tell, mut told) = tokio::sync::mpsc::channel(EACH);
        for number in 0..EACH {
            tokio::spawn(one(port, token.to_owned(), number, tell.clone()));
        }
        for _ in 0..EACH {
            told.recv().await.unwrap();
        }
        println!("crowded");
        sleep(Duration::from_secs(3600)).await;
    });
}

/// Comes again whenever it is shown out.
async fn one(port: u16, token: String, number: usize, tell: tokio::sync::mpsc::Sender<()>) {
    let mut first = Some(tell);
    loop {
        if let Ok(stream) = TcpStream::connect(("127.0.0.1", port)).await {
            if let Some(tell) = first.take() {
                tell.send(()).await.unwrap();
            }
            // Whatever ends it.
            let _ = misbehave(stream, port, &token, number % 6).await;
        }
        sleep(Duration::from_secs(3)).await;
    }
}

async fn misbehave(
    mut stream: TcpStream,
    port: u16,
    token: &str,
    kind: usize,
) -> std::io::Result<()> {
    let host = format!("Host: localhost:{port}\r\nAuthorization: Bearer {token}\r\n");
    let mut answer = [0; 4096];
    match kind {
        0 => {}
        1 => stream.write_all(format!("GET / HTTP/1.1\r\n{host}X-Half: ").as_bytes()).await?,
        2 => {
            for byte in
                format!("GET /runs HTTP/1.1\r\n{host}X-Slow: {}", "s".repeat(10_000)).bytes()
            {
                stream.write_all(&[byte]).await?;
                sleep(Duration::from_millis(200)).await;
            }
        }
        3 => {
            let head = "Content-Type: application/json\r\nContent-Length: 10000\r\n\r\n";
            let head = format!("POST {MACHINE}/acknowledge HTTP/1.1\r\n{host}{head}");
            stream.write_all(head.as_bytes()).await?;
            for _ in 0..10_000 {
                stream.write_all(b" ").await?;
                sleep(Duration::from_millis(200)).await;
            }
        }
        // Asks on and on, and takes no answer.
        4 => {
            let request = format!("GET /runs/1 HTTP/1.1\r\n{host}\r\n").repeat(20);
            stream.write_all(request.as_bytes()).await?;
            sleep(Duration::from_secs(60)).await;
        }
        _ => {
            let request = format!("GET {MACHINE}/events HTTP/1.1\r\n{host}\r\n");
            stream.write_all(request.as_bytes()).await?;
        }
    }
    while stream.read(&mut answer).await? > 0 {}
    Ok(())
}

/// Killed with this value.
struct Crowd(Child);

impl Drop for Crowd {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Crowd {
    fn at(guarded: &Guarded) -> Self {
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -n 4096 2>/dev/null; exec \"$0\""]);
        command
            .arg(std::env::current_exe().unwrap())
            .env(ASKED, format!("{} {}", guarded.port, guarded.metrologist));
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut told = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut told).unwrap();
        assert_eq!(told, "crowded\n");
        Self(child)
    }
}

/// The most memory that the daemon has had in it at once, KiB.
fn high_water(daemon: &Daemon) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", daemon.child.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().strip_suffix(" kB").unwrap().parse().unwrap()
}

/// The figures of the next run.
fn measure(guarded: &Guarded) -> Value {
    let before = guarded.standing()["run"].as_u64().unwrap();
    assert_eq!(guarded.post("start", &guarded.operator, &vouched()), 202);
    let ended = |now: &Value| now["state"] == "waiting" && now["run"].as_u64().unwrap() > before;
    guarded.until(ended)["parameters"].clone()
}

pub fn beside_a_run() {
    let guarded = Guarded::new("fast");
    let wanted = measure(&guarded);
    let calm_kib = high_water(&guarded.daemon);
    let crowds: Vec<Crowd> = (0..CROWDS).map(|_| Crowd::at(&guarded)).collect();
    // What was measured among them is what was measured without them, to the last digit.
    assert_eq!(measure(&guarded), wanted);
    assert!(wanted.as_array().unwrap().len() > 5);
    let crowd_kib = high_water(&guarded.daemon);
    println!("memory: {calm_kib} KiB at most without a crowd, {crowd_kib} KiB with it");
    assert!(crowd_kib < calm_kib + MOST_KIB, "{calm_kib} KiB, with a crowd {crowd_kib} KiB");
    drop(crowds);
    assert!(!guarded.daemon.log.lock().unwrap().contains("panicked"));
}

/// And it is held, whoever else is there.
pub fn and_a_hold() {
    let guarded = Guarded::new("real");
    let _crowds: Vec<Crowd> = (0..CROWDS).map(|_| Crowd::at(&guarded)).collect();
    assert_eq!(guarded.post("start", &guarded.operator, &vouched()), 202);
    guarded.until(|now| now["measured"].as_u64().unwrap() > 0);
    assert_eq!(guarded.post("hold", &guarded.viewer, &json!({})), 202);
    guarded.until(|now| now["state"] == "held");
    assert_eq!(guarded.shop.states(), ["held"]);
}
