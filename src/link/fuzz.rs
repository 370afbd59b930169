//! Any bytes, cut anywhere.

use super::lines::{Assembler, Received};
use crate::base::fuzz::fuzz;

const TALK: &[u8] = b"GrblHAL 1.1f ['$' or '$HELP' for help]\r\n<Idle|MPos:0.000,1.000>\r\nok\n";

#[test]
fn the_line_assembler_bears_anything() {
    let words = ["ok", "\r\n", "\n", "µ", "<Idle|", "\u{7f}"];
    fuzz("link-lines", &[TALK, &[b'a'; 9_000]], &words, |input| {
        let mut assembler = Assembler::default();
        let (size, rest) = input.split_first().map_or((1, input), |(size, rest)| (*size, rest));
        let pieces = rest.chunks(usize::from(size) + 1);
        let received: Vec<Received> = pieces.flat_map(|piece| assembler.take(piece)).collect();
        let mut said = 0;
        for one in &received {
            said += match one {
                Received::Line(line) => {
                    assert!(!line.contains('\n') && line.len() <= 4096, "{} bytes", line.len());
                    line.len() + 1
                }
                Received::Noise { bytes } => *bytes,
            };
        }
        assert!(said <= rest.len(), "{said} bytes out of {}", rest.len());
        said + received.len() * size_of::<Received>()
    });
}
