//! Assembles lines from bytes that arrive in any pieces. Unreadable bytes and endless lines are reported as noise.

/// Maximum length of a line including its ending, bytes; a longer line counts as noise.
const MAX_LINE_BYTES: usize = 4096;

/// Data that a peer has sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LineEvent {
    /// One complete line without its line ending.
    Line(String),
    /// A line with bytes that are not text (line noise, a wrong baud rate, a wrong device), or a line that is too
    /// long. `bytes`: length of the line so far, valid bytes included; the rest of the line is dropped.
    Noise { bytes: usize },
}

/// Assembles lines across reads.
#[derive(Debug, Default)]
pub(super) struct LineAssembler {
    partial_line: Vec<u8>,
    /// Whether the rest of a line that was reported as noise is dropped.
    is_skipping_line: bool,
}

impl LineAssembler {
    /// Returns all lines that `bytes` completes, in order. Noise is reported immediately, because the end of its
    /// line may never arrive.
    pub(super) fn push(&mut self, bytes: &[u8]) -> Vec<LineEvent> {
        let mut received = Vec::new();
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            let is_complete = piece.ends_with(b"\n");
            if !self.is_skipping_line {
                self.partial_line.extend_from_slice(piece);
                received.extend(self.take_line_or_noise(is_complete));
            }
            if is_complete {
                self.is_skipping_line = false;
            }
        }
        received
    }

    /// The line, if it is complete, or noise; `None`: the line has no fault so far, but is incomplete.
    fn take_line_or_noise(&mut self, is_complete: bool) -> Option<LineEvent> {
        let text = match std::str::from_utf8(&self.partial_line) {
            Ok(text) => Some(text),
            // A UTF-8 character may be split between two reads.
            Err(error) if error.error_len().is_none() && !is_complete => {
                std::str::from_utf8(&self.partial_line[..error.valid_up_to()]).ok()
            }
            Err(_) => None,
        };
        match text.filter(|text| text.len() <= MAX_LINE_BYTES && !text.contains(is_noise_character)) {
            Some(text) if is_complete => {
                let line = text.trim_end_matches(['\r', '\n']).to_owned();
                self.partial_line.clear();
                Some(LineEvent::Line(line))
            }
            Some(_) => None,
            None => {
                let bytes = self.partial_line.len();
                self.partial_line.clear();
                self.is_skipping_line = true;
                Some(LineEvent::Noise { bytes })
            }
        }
    }
}

/// Whether the character is a control character other than carriage return, line feed and tab.
fn is_noise_character(character: char) -> bool {
    character.is_control() && !matches!(character, '\r' | '\n' | '\t')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(text: &str) -> LineEvent {
        LineEvent::Line(text.to_owned())
    }

    #[test]
    fn lines_split_anywhere_are_assembled() {
        let bytes = "ok\r\n<Idle|µ>\n\nerror:9\r\n".as_bytes();
        for cut in 0..bytes.len() {
            let mut assembler = LineAssembler::default();
            let mut received = assembler.push(&bytes[..cut]);
            received.extend(assembler.push(&bytes[cut..]));
            let expected = [line("ok"), line("<Idle|µ>"), line(""), line("error:9")];
            assert_eq!(received, expected, "cut at {cut}");
        }
    }

    #[test]
    fn noise_is_reported_and_its_line_dropped() {
        let mut assembler = LineAssembler::default();
        assert_eq!(assembler.push(b"<Id\xff\xfe"), [LineEvent::Noise { bytes: 5 }]);
        assert_eq!(assembler.push(b"le|MPos:1.000>\nok\n"), [line("ok")]);
    }

    #[test]
    fn endless_line_is_noise_and_uses_bounded_memory() {
        let mut assembler = LineAssembler::default();
        let events: Vec<LineEvent> = (0..100).flat_map(|_| assembler.push(&[b'a'; 1000])).collect();
        assert_eq!(events, [LineEvent::Noise { bytes: 5000 }]);
        assert_eq!(assembler.push(b"\nok\n"), [line("ok")]);
    }
}
