//! Fuzz tests: arbitrary text from linuxcncrsh and in a result log.

use tokio::io::AsyncWriteExt;

use super::prepare;
use super::result_log::{ProgramResult, ResultLog};
use super::rsh::RshClient;
use crate::controllers::ControllerError;
use link::LineLink;
use machine::Axis;
use testing::fuzz::fuzz_parser;

const SAMPLE_LOG: &[u8] = b"state 2.9 0.0 0.0 0.0 0.0 0.0 0.0 0.0 0.0 0.0 0.0 0.0
from 17 4 50.000000 0.000000 60.000000
guarded 17 3 0.000000 50.000000 0.000000 60.000000
touch 17 4 1.000000 47.900000 0.000000 60.000000 0.000000 0.000000 90.000000
END
";
const SAMPLE_REPLIES: &[u8] = b"SET VERBOSE ACK\n\rESTOP OFF\r\nMACHINE ON\r\n\
    ABS_ACT_POS -47.990000 0.0 12.5 0.0 0.0 45.0 0.0 0.0 0.0\r\n\
    JOINT_HOMED YES YES YES YES YES NO\r\nPROGRAM_STATUS IDLE\r\nGET ESTOP NAK\r\n";

#[test]
fn fuzz_result_log() {
    let words = ["END\n", "offset\n", "state ", "from 17 4 ", "guarded 17 3 ", "touch 17 4 ", "1.0 "];
    fuzz_parser("linuxcnc-log", &[SAMPLE_LOG], &words, |input| {
        let text = String::from_utf8_lossy(input);
        let Ok(log) = ResultLog::parse(&text, 17) else { return 0 };
        assert!(log.line_count <= input.len());
        assert!(log.state_values.iter().all(|value| value.is_finite()), "{log:?}");
        // `check_state_values` must not panic either.
        drop(prepare::check_state_values(&log.state_values, &Axis::ALL));
        if let Some(ProgramResult::Touch(at)) = &log.result {
            assert!(at.iter().all(|(_, value)| value.is_finite()), "{log:?}");
        }
        size_of_val(log.state_values.as_slice())
    });
}

#[test]
fn fuzz_linuxcncrsh_replies() {
    let words = ["ESTOP ", "SET VERBOSE ACK", "GET ESTOP NAK", "ABS_ACT_POS ", "OFF", "\r\n", "\n\r"];
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    fuzz_parser("linuxcnc-answers", &[SAMPLE_REPLIES], &words, |input| runtime.block_on(query_fuzzed_server(input)));
}

/// Sends requests until the peer, which sends `input` and disconnects, is gone; returns the number
/// of bytes understood.
async fn query_fuzzed_server(input: &[u8]) -> usize {
    let (near, mut far) = tokio::io::duplex(input.len() + 1);
    far.write_all(input).await.unwrap();
    drop(far);
    let mut rsh =
        RshClient { link: LineLink::from_stream("peer", near), server_identity: String::new(), halt_handle: None };
    let mut heard = 0;
    for key in ["estop", "machine", "abs_act_pos", "joint_homed", "program_status"] {
        match rsh.get(key).await {
            Ok(answer) => {
                heard += answer.len();
                drop(prepare::check_estop_power_and_homing("OFF", "ON", &answer, &Axis::ALL, None));
                if let Ok(at) = super::state::parse_numbers(&answer) {
                    assert!(at.iter().all(|value| value.is_finite()), "{answer}");
                }
            }
            Err(ControllerError::Link(_)) => return heard,
            Err(error) => assert!(error.to_string().len() <= input.len() + 200, "{error}"),
        }
    }
    heard
}
