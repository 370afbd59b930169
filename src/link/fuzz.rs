//! Fuzz tests: arbitrary bytes, split at arbitrary positions.

use super::CaptureReplay;
use super::capture::LinkProtocol;
use super::line_assembler::{LineAssembler, LineEvent};
use testing::fuzz::fuzz_parser;

const GRBL_LINES: &[u8] = b"GrblHAL 1.1f ['$' or '$HELP' for help]\r\n<Idle|MPos:0.000,1.000>\r\nok\n";

#[test]
fn fuzz_line_assembler() {
    let words = ["ok", "\r\n", "\n", "µ", "<Idle|", "\u{7f}"];
    fuzz_parser("link-lines", &[GRBL_LINES, &[b'a'; 9_000]], &words, |input| {
        let mut assembler = LineAssembler::default();
        let (size, rest) = input.split_first().map_or((1, input), |(size, rest)| (*size, rest));
        let pieces = rest.chunks(usize::from(size) + 1);
        let received: Vec<LineEvent> = pieces.flat_map(|piece| assembler.push(piece)).collect();
        let mut accounted_bytes = 0;
        for one in &received {
            accounted_bytes += match one {
                LineEvent::Line(line) => {
                    assert!(!line.contains('\n') && line.len() <= 4096, "{} bytes", line.len());
                    line.len() + 1
                }
                LineEvent::Noise { bytes } => *bytes,
            };
        }
        assert!(accounted_bytes <= rest.len(), "{accounted_bytes} bytes out of {}", rest.len());
        accounted_bytes + received.len() * size_of::<LineEvent>()
    });
}

const CAPTURE_FILE_BYTES: &[u8] = b"# trued-capture 1\n0.1 1 = lines a\n0.2 1 > $I\\n\n0.3 1 < ok\\r\\n\n0.4 1 > ?\n\
0.5 1 < <Idle>\\n\n0.6 2 = modbus-tcp b\n0.7 2 > \\x00\\x01\\x00\\x00\\x00\\x06\\x01\\x03\\x00\\x00\\x00\\x01\n\
0.8 3 = modbus-rtu c\n0.9 3 > \\x01\\x03\\x00\\x00\\x00\\x01\\x84\\x0a\n\
1.0 4 = files d\n1.1 4 > a.ngc\\nG0\n1.2 4 < a.log\n1.3 4 < a.log\\nEND\\n\n";

#[test]
fn fuzz_capture_reader() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.capture");
    let words = [" 1 < ", " 1 > ", " 2 = modbus-tcp ", "\\x", "# trued-capture 1\n"];
    fuzz_parser("capture", &[CAPTURE_FILE_BYTES], &words, |input| {
        std::fs::write(&file, input).unwrap();
        match CaptureReplay::read(&file) {
            Ok(replay) => {
                for protocol in LinkProtocol::ALL {
                    replay.take_link_replay("a", protocol).process_sent_bytes(&[b"$I\n?", input].concat());
                }
                input.len()
            }
            Err(error) => error.to_string().len(),
        }
    });
}
