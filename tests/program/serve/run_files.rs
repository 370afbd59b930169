//! Files of a run over HTTP.

use crate::support::http::{HTTP_SECTION, start_request_body};
use crate::support::machine_shop::{MachineShop, stderr};
use std::io::{Read, Write};

/// A download has the bytes that `trued export` writes, a content type and a file name.
pub fn downloads_equal_the_exported_files() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    assert_eq!(http.post_action("start", &start_request_body()).0, 202);
    http.wait_until_machine_state(|machine| machine["result"]["run"] == 1);
    let exported = shop.run_trued(&["export", "1", "--to", &shop.path_text("export")]);
    assert!(exported.status.success(), "{}", stderr(&exported));
    for (address, kind) in [("readings.csv", "text/csv; charset=utf-8"), ("estimate.json", "application/json")] {
        let mut stream = http.connect();
        let port = http.port;
        write!(stream, "GET /api/v1/runs/1/{address} HTTP/1.1\r\nHost: localhost:{port}\r\nConnection: close\r\n\r\n")
            .unwrap();
        let mut response = String::new();
        stream.read_to_string(&mut response).unwrap();
        let (head, body) = response.split_once("\r\n\r\n").unwrap();
        assert!(head.starts_with("HTTP/1.1 200"), "{head}");
        let file_name = format!("run-1-{address}");
        for field in [
            format!("content-type: {kind}\r\n"),
            format!("content-disposition: attachment; filename=\"{file_name}\"\r\n"),
        ] {
            assert!(head.contains(&field), "{field} in {head}");
        }
        let file = std::fs::read_to_string(shop.path("export").join(&file_name)).unwrap();
        assert!(file.len() > 1000 && file == body, "{file_name}: {} and {} bytes", file.len(), body.len());
    }
    let page = http.get_json("/api/v1/runs/1/readings");
    let lines = http.get_text("/api/v1/runs/1/readings.csv");
    // The line of column names precedes the readings.
    let rows = lines.lines().filter(|line| !line.starts_with('#')).count() - 1;
    assert_eq!(page["all"].as_u64().unwrap() as usize, rows);
}
