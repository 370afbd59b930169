//! Clients that make no progress are disconnected in the end; clients that make progress are not.

use crate::support::http::{HTTP, HttpClient, JSON, MACHINE};
use crate::support::machine_shop::MachineShop;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::{scope, sleep};
use std::time::{Duration, Instant};

/// More than twice the limit of docs/page.md, because this computer may be busy.
const IN_THE_END: Duration = Duration::from_secs(60);
/// More requests than the socket buffers of both sides hold.
const MANY: usize = 1000;

struct Caller {
    stream: TcpStream,
    port: u16,
}

impl Caller {
    fn new(port: u16) -> Self {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(IN_THE_END)).unwrap();
        stream.set_write_timeout(Some(Duration::from_secs(2))).unwrap();
        Self { stream, port }
    }

    /// Sends the beginning of a request.
    fn begins(mut self, line: &str, headers: &str) -> Self {
        let host = format!("Host: localhost:{}\r\n", self.port);
        self.stream.write_all(format!("{line} HTTP/1.1\r\n{host}{headers}").as_bytes()).unwrap();
        self
    }

    /// Sends single bytes until the server has closed.
    fn goes_on_and_on(&self) {
        let (mut stream, started) = (&self.stream, Instant::now());
        while stream.write_all(b"a").is_ok() {
            assert!(started.elapsed() < IN_THE_END, "it listens on and on");
            sleep(Duration::from_millis(100));
        }
    }

    /// All bytes received until the end.
    fn told(mut self) -> Vec<u8> {
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

    fn shown_out(self) {
        let told = self.told();
        let told = String::from_utf8_lossy(&told);
        assert!(told.is_empty() || told.starts_with("HTTP/1.1 4"), "{told}");
    }
}

pub fn shown_out() {
    let shop = MachineShop::with_serve(HTTP);
    let daemon = shop.serve("fast");
    let http = daemon.http();
    let port = http.port;
    let caller = || Caller::new(port);
    scope(|scope| {
        scope.spawn(|| caller().shown_out());
        scope.spawn(|| caller().begins("GET /", "X-More: a").shown_out());
        for line in ["GET /", "POST /login"] {
            scope.spawn(move || {
                let caller = Caller::new(port).begins(line, "X-More: ");
                caller.goes_on_and_on();
                caller.shown_out();
            });
        }
        scope.spawn(|| {
            let start = format!("POST {MACHINE}/start");
            let caller = caller().begins(&start, &format!("{JSON}Content-Length: 90000\r\n\r\n"));
            caller.goes_on_and_on();
            let told = String::from_utf8(caller.told()).unwrap();
            assert!(told.is_empty() || told.starts_with("HTTP/1.1 408"), "{told}");
        });
        scope.spawn(|| takes_no_answer(caller()));
    });
    assert_eq!(http.request("GET", "/runs", "", "").0, 200);
    assert!(!daemon.log().contains("panicked"));
}

/// Sends requests and reads nothing until the server gives up the remaining responses.
fn takes_no_answer(mut caller: Caller) {
    let host = format!("Host: localhost:{}\r\n\r\n", caller.port);
    let request = format!("GET /api/v1/openapi.json HTTP/1.1\r\n{host}");
    let (_, whole) = HttpClient::at(caller.port).request("GET", "/api/v1/openapi.json", "", "");
    // The buffers are full, because nothing is read.
    let asked = (0..MANY).take_while(|_| caller.stream.write_all(request.as_bytes()).is_ok()).count();
    sleep(Duration::from_secs(25));
    let told = caller.told().len();
    println!("{told} bytes of {asked} answers of {}", whole.len());
    assert!(told > 0 && told < whole.len() * asked, "{told} bytes of {asked} answers");
}
