//! Clients that make no progress are disconnected in the end; clients that make progress are not.

use crate::support::http::{HTTP_SECTION, HttpClient, JSON_HEADER, MACHINE_API_PATH};
use crate::support::machine_shop::MachineShop;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::{scope, sleep};
use std::time::{Duration, Instant};

/// More than twice the limit of docs/page.md, because this computer may be busy.
const MAX_REQUEST_DURATION: Duration = Duration::from_secs(60);
/// More requests than the socket buffers of both sides hold.
const BUFFER_FILLING_REQUEST_COUNT: usize = 1000;

struct SlowClient {
    stream: TcpStream,
    port: u16,
}

impl SlowClient {
    fn new(port: u16) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(MAX_REQUEST_DURATION)).unwrap();
        stream.set_write_timeout(Some(Duration::from_secs(2))).unwrap();
        Self { stream, port }
    }

    /// Sends the beginning of a request.
    fn send_request_start(mut self, line: &str, headers: &str) -> Self {
        let host = format!("Host: localhost:{}\r\n", self.port);
        self.stream.write_all(format!("{line} HTTP/1.1\r\n{host}{headers}").as_bytes()).unwrap();
        self
    }

    /// Sends single bytes until the server has closed.
    fn send_bytes_until_closed(&self) {
        let (mut stream, started) = (&self.stream, Instant::now());
        while stream.write_all(b"a").is_ok() {
            assert!(started.elapsed() < MAX_REQUEST_DURATION, "it listens on and on");
            sleep(Duration::from_millis(100));
        }
    }

    /// All bytes received until the server closes the connection.
    fn read_until_closed(mut self) -> Vec<u8> {
        let (mut told, mut some) = (Vec::new(), [0; 65536]);
        loop {
            match self.stream.read(&mut some) {
                Ok(0) => return told,
                Ok(count) => told.extend(&some[..count]),
                // The server closed with unread bytes from the client.
                Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => return told,
                Err(error) => panic!("not shown out: {error}"),
            }
        }
    }

    fn wait_until_closed(self) {
        let told = self.read_until_closed();
        let told = String::from_utf8_lossy(&told);
        assert!(told.is_empty() || told.starts_with("HTTP/1.1 4"), "{told}");
    }
}

pub fn slow_clients_are_disconnected() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let port = http.port;
    let caller = || SlowClient::new(port);
    scope(|scope| {
        scope.spawn(|| caller().wait_until_closed());
        scope.spawn(|| caller().send_request_start("GET /", "X-More: a").wait_until_closed());
        for line in ["GET /", "POST /login"] {
            scope.spawn(move || {
                let caller = SlowClient::new(port).send_request_start(line, "X-More: ");
                caller.send_bytes_until_closed();
                caller.wait_until_closed();
            });
        }
        scope.spawn(|| {
            let start = format!("POST {MACHINE_API_PATH}/start");
            let caller = caller().send_request_start(&start, &format!("{JSON_HEADER}Content-Length: 90000\r\n\r\n"));
            caller.send_bytes_until_closed();
            let told = String::from_utf8(caller.read_until_closed()).unwrap();
            assert!(told.is_empty() || told.starts_with("HTTP/1.1 408"), "{told}");
        });
        scope.spawn(|| check_client_that_does_not_read(caller()));
    });
    assert_eq!(http.request("GET", "/runs", "", "").0, 200);
    assert!(!daemon.log().contains("panicked"));
}

/// Sends requests and reads nothing until the server gives up the remaining responses.
fn check_client_that_does_not_read(mut caller: SlowClient) {
    let host = format!("Host: localhost:{}\r\n\r\n", caller.port);
    let request = format!("GET /api/v1/openapi.json HTTP/1.1\r\n{host}");
    let (_, whole) = HttpClient::new(caller.port).request("GET", "/api/v1/openapi.json", "", "");
    // The buffers are full, because nothing is read.
    let asked =
        (0..BUFFER_FILLING_REQUEST_COUNT).take_while(|_| caller.stream.write_all(request.as_bytes()).is_ok()).count();
    sleep(Duration::from_secs(25));
    let told = caller.read_until_closed().len();
    println!("{told} bytes of {asked} answers of {}", whole.len());
    assert!(told > 0 && told < whole.len() * asked, "{told} bytes of {asked} answers");
}
