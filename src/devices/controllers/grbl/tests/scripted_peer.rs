//! Scripted peers of the driver. A healthy peer reaches its target and answers as a real grblHAL does (from
//! transcripts); a test replaces some of its answers.

use std::sync::{Arc, Mutex};

use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};

use link::LineLink;

/// All text that the driver has sent to the peer.
pub type SentText = Arc<Mutex<String>>;

/// Answer to `?`.
pub const IDLE_REPORT: &str = "<Idle|MPos:{at}|Bf:100,1023|FS:0,0|Ov:100,100,100|A:|TLR:0>\r\n";

/// Answer to 0x87, the request for all fields.
pub const FULL_REPORT: &str = "<Idle|MPos:{at}|Bf:100,1023|FS:0,0|WCO:0.000,0.000,0.000,0.000,0.000|\
    Ov:100,100,100|A:|MPG:0|H:1,31|T:0|TLR:0|FW:grblHAL>\r\n";

/// Reply of a healthy control to `$$`, with the settings that the driver reads.
pub const SETTINGS_REPLY: &str = "$10=511\r\n$13=0\r\n$20=1\r\n$22=35\r\n$130=400.000\r\n$131=400.000\r\n\
    $132=400.000\r\nok\r\n";

/// Starts a peer that exchanges bytes only: `answer` is called for every line, and for `?`, `!` and 0x87 (as `0x87`)
/// when they arrive.
pub fn spawn_scripted_peer(mut answer: impl FnMut(&str) -> Option<String> + Send + 'static) -> (LineLink, SentText) {
    let (ours, theirs) = tokio::io::duplex(4096);
    let sent = SentText::default();
    let copy = sent.clone();
    tokio::spawn(async move { serve_peer(theirs, &copy, &mut answer).await });
    (LineLink::from_stream("the bench", ours), sent)
}

async fn serve_peer(
    mut stream: DuplexStream,
    sent: &SentText,
    answer: &mut (dyn FnMut(&str) -> Option<String> + Send),
) {
    let mut line = String::new();
    while let Ok(byte) = stream.read_u8().await {
        sent.lock().unwrap().push(byte as char);
        let said = match byte {
            b'?' | b'!' => answer(&(byte as char).to_string()),
            0x87 => answer("0x87"),
            b'\n' => answer(&std::mem::take(&mut line)),
            byte => {
                line.push(byte as char);
                continue;
            }
        };
        let said = said.unwrap_or_default();
        if said == "HANG UP" || stream.write_all(&latin1_bytes(&said)).await.is_err() {
            return;
        }
    }
}

/// Converts text to Latin-1, so that a script may contain any byte.
fn latin1_bytes(text: &str) -> Vec<u8> {
    text.chars().map(|c| c as u8).collect()
}

/// Position of the healthy control, and its last probing move. The stylus touches the part at the end of a
/// touch; the tests distinguish touches from guarded moves by the feed.
#[derive(Default)]
struct HealthyPeer {
    position: [f64; 5],
    last_probe_result: String,
}

impl HealthyPeer {
    fn format_position(&self) -> String {
        self.position.map(|value| format!("{value:.3}")).join(",")
    }

    fn execute_motion(&mut self, line: &str) {
        for word in line.split_whitespace() {
            let axis = "XYZBC".find(&word[..1]);
            if let (Some(axis), Ok(value)) = (axis, word[1..].parse()) {
                self.position[axis] = value;
            }
        }
        if line.contains("G38") {
            self.last_probe_result = format!("[PRB:{}:{}]", self.format_position(), u8::from(line.contains("F30.")));
        }
    }

    fn reply(&mut self, line: &str) -> &'static str {
        match line {
            "?" => IDLE_REPORT,
            "0x87" => FULL_REPORT,
            "!" => "",
            "$I" => "[VER:1.1f.20260817:]\r\n[OPT:VNML+,100,1024,5,0]\r\n[AXS:5:XYZBC]\r\nok\r\n",
            "$G" => "[GC:G0 G59 G17 G21 G90 G94 G49 G98 G50 M5 M9 T0 F0 S0.]\r\nok\r\n",
            "$#" => {
                "[G59:0.000,0.000,0.000,0.000,0.000]\r\n[G92:0.000,0.000,0.000,0.000,0.000]\r\n\
                 [HOME:0.000,0.000,0.000,0.000,0.000:31]\r\n[TLO:0.000,0.000,0.000]\r\n{told}\r\nok\r\n"
            }
            "$$" => SETTINGS_REPLY,
            probing if probing.contains("G38") => "{told}\r\nok\r\n",
            _ => "ok\r\n",
        }
    }
}

/// Starts a healthy peer, except that `odd` replaces some of its replies. In a reply, `{at}` is replaced by the
/// position and `{told}` by the last [PRB:..]; if the reply begins with `>`, the peer also executes the line.
pub fn spawn_peer_with_odd_replies(
    mut odd: impl FnMut(&str) -> Option<String> + Send + 'static,
) -> (LineLink, SentText) {
    let mut healthy = HealthyPeer::default();
    spawn_scripted_peer(move |line| {
        let said = odd(line);
        let obeys = said.as_ref().is_none_or(|said| said.starts_with('>'));
        if obeys && line.contains('G') && !line.contains("G10") && !line.starts_with('$') {
            healthy.execute_motion(line);
        }
        let said = said.unwrap_or_else(|| healthy.reply(line).to_owned());
        let said = said.trim_start_matches('>').replace("{at}", &healthy.format_position());
        Some(said.replace("{told}", &healthy.last_probe_result))
    })
}
