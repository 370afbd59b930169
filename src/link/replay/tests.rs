use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::Instant;

use super::*;
use crate::{CaptureWriter, LineEvent, LineLink, LinkMode};

fn parse_replay(capture_text: &str) -> Result<CaptureReplay, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.capture");
    std::fs::write(&file, capture_text).unwrap();
    CaptureReplay::read(&file).map_err(|error| {
        let message = error.to_string();
        message.rsplit_once('/').map_or(message.clone(), |(_, message)| message.to_owned())
    })
}

async fn next_line(link: &mut LineLink) -> String {
    match link.recv_deadline(Instant::now() + Duration::from_secs(5)).await {
        Ok(Some(LineEvent::Line(line))) => line,
        other => format!("{other:?}"),
    }
}

const GRBL_CAPTURE: &str = "# trued-capture 1
# by hand
0.1 1 = lines port
0.2 1 < Grbl 1.1\\r\\n
0.3 1 > $I\\n
0.4 1 < [VER:1.1]\\r\\nok\\r
0.5 1 < \\n
0.6 1 > G1X2\\n
0.7 1 > ?
0.8 1 < <Run>\\r\\nok\\r\\n
0.9 1 > ?
1.0 1 < <Idle>\\r\\n
1.1 1 > M2\\n
1.2 1 < ok\\r\\n
";

#[tokio::test]
async fn replay_gives_replies_by_command_and_reports_on_query() {
    let replay = parse_replay(GRBL_CAPTURE).unwrap();
    let clock = replay.clock();
    let (near, _far) = tokio::io::duplex(64);
    let mut link = LinkMode::Replayed(replay).apply_to(async { LineLink::from_stream("port", near) }).await;
    assert_eq!(next_line(&mut link).await, "Grbl 1.1");
    link.send_line("$I").unwrap();
    assert_eq!(next_line(&mut link).await, "[VER:1.1]");
    assert_eq!(next_line(&mut link).await, "ok");
    assert_eq!(clock.now_s(), 0.5);
    link.send(b"?").unwrap();
    link.send_line("G1X2").unwrap();
    assert_eq!(next_line(&mut link).await, "ok");
    // More polls than in the capture.
    for report in ["<Run>", "<Idle>", "<Idle>", "<Idle>"] {
        link.urgent_sender().send(b"?");
        assert_eq!(next_line(&mut link).await, report);
    }
    link.send_line("M3").unwrap();
    let lost = next_line(&mut link).await;
    assert!(lost.contains("the capture has no `M3` at this point; its next command is `M2`"), "{lost}");
}

#[tokio::test]
async fn capture_is_written_as_text_and_parsed_back() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.capture");
    let capture = CaptureWriter::create(&file).unwrap();
    assert!(CaptureWriter::create(&file).is_err(), "a capture is never overwritten");
    let (near, mut far) = tokio::io::duplex(64);
    let mode = LinkMode::Captured(capture.clone());
    let mut link = mode.apply_to(async { LineLink::from_stream("the \"port\"", near) }).await;
    link.send_line("G1 X-2.5").unwrap();
    let mut sent = [0; 9];
    far.read_exact(&mut sent).await.unwrap();
    far.write_all(b"[MSG:a\\b \"c\"]\r\n").await.unwrap();
    assert_eq!(next_line(&mut link).await, "[MSG:a\\b \"c\"]");
    link.send(&[0x18, 0xFF]).unwrap();
    far.read_exact(&mut sent[..2]).await.unwrap();
    // Bytes are recorded after they are sent, so the reply is recorded after them.
    far.write_all(b"ok\r\n").await.unwrap();
    assert_eq!(next_line(&mut link).await, "ok");
    capture.finish().unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    let without_times: Vec<_> = text.lines().map(|line| line.split_once(' ').unwrap().1).collect();
    assert_eq!(
        without_times,
        [
            "trued-capture 1",
            "1 = lines the \"port\"",
            r"1 > G1 X-2.5\n",
            r#"1 < [MSG:a\\b \"c\"]\r\n"#,
            r"1 > \x18\xff",
            r"1 < ok\r\n",
        ]
    );
    let links = capture_parser::parse_capture("a.capture", &text).unwrap();
    let capture_parser::Transfer::Received(received) = &links[0].transfers[1] else { panic!() };
    assert_eq!(received.bytes, b"[MSG:a\\b \"c\"]\r\n");
}

#[test]
fn damaged_capture_is_refused_with_a_reason() {
    let error_of = |text: &str| parse_replay(text).err().unwrap();
    assert_eq!(
        error_of("G1 X2\n"),
        "a.capture, line 1: the file does not begin with `# trued-capture 1`: the file is not a capture, or \
         it was cut or changed"
    );
    for (spoilt, line, why) in [
        (GRBL_CAPTURE.replace("0.6 1 >", "soon 1 >"), 8, "the first column is not a time"),
        (GRBL_CAPTURE.replace("0.6 1 >", "NaN 1 >"), 8, "the first column is not a time"),
        (GRBL_CAPTURE.replace("0.6 1 >", "0.6 2 >"), 8, "the link was not opened"),
        (GRBL_CAPTURE.replace("0.6 1 >", "0.6 one >"), 8, "the second column is not the number of a link"),
        (GRBL_CAPTURE.replace("0.6 1 >", "0.6 1 ="), 8, ""),
        (GRBL_CAPTURE.replace("0.6 1 >", "0.6 1 ]"), 8, "the third column is not"),
        (GRBL_CAPTURE.replace("G1X2\\n", "G1X2\\q"), 8, "the content has an unknown escape"),
        (GRBL_CAPTURE.replace("G1X2\\n", "G1X2\\x9"), 8, "the content has an unknown escape"),
        (GRBL_CAPTURE.replace("G1X2\\n", "G1X2\t"), 8, "the content has an unprintable byte"),
        (GRBL_CAPTURE.replace("= lines", "= words"), 3, "the fourth column does not begin with a known link protocol"),
        (GRBL_CAPTURE.replace("0.7 1 > ?", "0.7 1 >"), 9, "the line has too few columns"),
        (GRBL_CAPTURE.trim_end().to_owned(), 14, "the last line has no line end"),
    ] {
        if why.is_empty() {
            assert!(parse_replay(&spoilt).is_ok());
            continue;
        }
        let message = error_of(&spoilt);
        assert!(message.starts_with(&format!("a.capture, line {line}: {why}")), "{message}");
    }
}
