//! Assembles lines from bytes that arrive in any pieces. Unreadable bytes and endless lines are reported as noise.

/// Maximum length of a line, bytes; a longer line counts as noise.
const LONGEST: usize = 4096;

/// Data that a peer has sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Received {
    /// One complete line without its line ending.
    Line(String),
    /// Bytes that are not text: line noise, a wrong baud rate, a wrong device. The rest of the same line is
    /// dropped.
    Noise { bytes: usize },
}

/// Assembles lines across reads.
#[derive(Debug, Default)]
pub(super) struct Assembler {
    partial: Vec<u8>,
    skipping: bool,
}

impl Assembler {
    /// Returns all lines that `bytes` completes, in order. Noise is reported immediately, because the end of its
    /// line may never arrive.
    pub(super) fn take(&mut self, bytes: &[u8]) -> Vec<Received> {
        let mut received = Vec::new();
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            let complete = piece.ends_with(b"\n");
            if !self.skipping {
                self.partial.extend_from_slice(piece);
                received.extend(self.judge(complete));
            }
            if complete {
                self.skipping = false;
            }
        }
        received
    }

    fn judge(&mut self, complete: bool) -> Option<Received> {
        let text = match std::str::from_utf8(&self.partial) {
            Ok(text) => Some(text),
            // A UTF-8 character may be split between two reads.
            Err(error) if error.error_len().is_none() && !complete => {
                std::str::from_utf8(&self.partial[..error.valid_up_to()]).ok()
            }
            Err(_) => None,
        };
        match text.filter(|text| text.len() <= LONGEST && !text.contains(is_noise)) {
            Some(text) if complete => {
                let line = text.trim_end_matches(['\r', '\n']).to_owned();
                self.partial.clear();
                Some(Received::Line(line))
            }
            Some(_) => None,
            None => {
                let bytes = self.partial.len();
                self.partial.clear();
                self.skipping = true;
                Some(Received::Noise { bytes })
            }
        }
    }
}

fn is_noise(character: char) -> bool {
    character.is_control() && !matches!(character, '\r' | '\n' | '\t')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(text: &str) -> Received {
        Received::Line(text.to_owned())
    }

    #[test]
    fn lines_split_anywhere_come_out_whole() {
        let bytes = "ok\r\n<Idle|µ>\n\nerror:9\r\n".as_bytes();
        for cut in 0..bytes.len() {
            let mut assembler = Assembler::default();
            let mut received = assembler.take(&bytes[..cut]);
            received.extend(assembler.take(&bytes[cut..]));
            let expected = [line("ok"), line("<Idle|µ>"), line(""), line("error:9")];
            assert_eq!(received, expected, "cut at {cut}");
        }
    }

    #[test]
    fn noise_is_told_at_once_and_its_line_dropped() {
        let mut assembler = Assembler::default();
        assert_eq!(assembler.take(b"<Id\xff\xfe"), [Received::Noise { bytes: 5 }]);
        assert_eq!(assembler.take(b"le|MPos:1.000>\nok\n"), [line("ok")]);
    }

    #[test]
    fn an_endless_line_is_noise_not_memory() {
        let mut assembler = Assembler::default();
        let told: Vec<Received> = (0..100).flat_map(|_| assembler.take(&[b'a'; 1000])).collect();
        assert_eq!(told, [Received::Noise { bytes: 5000 }]);
        assert_eq!(assembler.take(b"\nok\n"), [line("ok")]);
    }
}
