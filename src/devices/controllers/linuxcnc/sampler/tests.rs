//! Tests of the sampler's handle with lines over TCP, in real time.

use std::io::Write;
use std::net::TcpListener;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::SeqCst;
use std::thread;

use super::*;
use link::clock::HostClock;

const AXES: [Axis; 3] = [Axis::X, Axis::C, Axis::S];

/// Sends the text that `line` returns for each tick, ten ticks every ten milliseconds, until `line` returns
/// `None`; then sends nothing for a while.
fn start_scripted_halsampler(line: impl Fn(i64) -> Option<String> + Send + 'static) -> SamplerConfig {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let begun = std::time::Instant::now();
        for batch in 0_u32..800 {
            let lines = (0..10).map(|tick| line(i64::from(batch * 10 + tick)));
            match lines.collect::<Option<String>>() {
                Some(lines) if stream.write_all(lines.as_bytes()).is_ok() => {}
                Some(_) => return,
                None => break,
            }
            let next = Duration::from_millis(10) * (batch + 1);
            thread::sleep(next.saturating_sub(begun.elapsed()));
        }
        thread::sleep(2 * MAX_TICK_DELAY);
    });
    SamplerConfig { tcp: HostPort::local(port), period_s: 0.001, axes: None }
}

fn position(x: f64, c_deg: f64) -> Position {
    Position::new().with(Axis::X, x).with(Axis::C, c_deg.to_radians())
}

async fn open_sampler(config: &SamplerConfig) -> SamplerClient {
    SamplerClient::open(config, &AXES, Arc::new(HostClock::start())).await.unwrap()
}

fn valid_sampler_line(tick: i64) -> Option<String> {
    Some(format!("{tick} 2.000000 90.000000 0 \n"))
}

async fn refusal_text(config: &SamplerConfig, control_position: Position) -> String {
    let error =
        open_sampler(config).await.check_agreement_with_control(&control_position, &AXES, 1.0).await.unwrap_err();
    assert!(matches!(error, ControllerError::NotReady { .. }), "{error:?}");
    format!("{error}; {}", error.remedy())
}

#[tokio::test]
async fn consistent_ticks_are_recorded_during_a_block() {
    let mut sampler = open_sampler(&start_scripted_halsampler(valid_sampler_line)).await;
    sampler.check_agreement_with_control(&position(50.8, 90.0), &AXES, 25.4).await.unwrap();
    sampler.start_recording();
    let begun_s = sampler.clock.now_s();
    sleep(Duration::from_millis(300)).await;
    let track = sampler.finish_recording(3, &position(50.8, 90.0)).await.unwrap();
    assert_eq!(track.gap_count(), 0);
    let at = track.position_at(begun_s + 0.15).unwrap();
    assert!((at.get_or_zero(Axis::X) - 50.8).abs() < 1e-9 && at.get(Axis::S).is_none(), "{at:?}");
    assert!(track.position_count() >= 300, "{}", track.position_count());
    let elsewhere = sampler.finish_recording(4, &position(50.8, 88.0)).await.unwrap_err();
    let said = format!("{elsewhere}; {}", elsewhere.remedy());
    assert!(said.contains("step 4") && said.contains("C is at 88.000"), "{said}");
}

#[tokio::test]
async fn wrong_pins_lines_axes_and_period_are_refused_before_motion() {
    let swapped = refusal_text(&start_scripted_halsampler(valid_sampler_line), position(90.0, 2.0)).await;
    assert!(swapped.contains("X is at 90.000") && swapped.contains("joint.N.pos-fb"), "{swapped}");
    // Lines without the bit.
    let config = start_scripted_halsampler(|tick| Some(format!("{tick} 2.0 90.0 \n")));
    let other = refusal_text(&config, position(2.0, 90.0)).await;
    assert!(other.contains("received `") && other.contains("2 positions and a bit"), "{other}");
    let few = SamplerConfig { axes: Some(vec![Axis::X]), ..start_scripted_halsampler(valid_sampler_line) };
    let few = refusal_text(&few, position(2.0, 90.0)).await;
    assert!(few.contains("does not record axis C"), "{few}");
    let slow = SamplerConfig { period_s: 0.002, ..start_scripted_halsampler(valid_sampler_line) };
    let slow = refusal_text(&slow, position(2.0, 90.0)).await;
    assert!(slow.contains("period_s"), "{slow}");
}

#[tokio::test]
async fn silent_or_unreachable_sampler_is_reported() {
    let silent = Arc::new(AtomicBool::new(false));
    let known = silent.clone();
    let quiet = start_scripted_halsampler(move |tick| if known.load(SeqCst) { None } else { valid_sampler_line(tick) });
    let mut sampler = open_sampler(&quiet).await;
    sampler.check_agreement_with_control(&position(2.0, 90.0), &AXES, 1.0).await.unwrap();
    sampler.start_recording();
    silent.store(true, SeqCst);
    sleep(Duration::from_millis(700)).await;
    let error = sampler.finish_recording(5, &position(2.0, 90.0)).await.unwrap_err();
    assert!(matches!(error, ControllerError::MissingPositionTrack { step: 5, .. }), "{error:?}");
    assert!(error.to_string().contains("no new line"), "{error}");
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let nobody = SamplerConfig { tcp: HostPort::local(free), period_s: 0.001, axes: None };
    let closed = SamplerClient::open(&nobody, &AXES, Arc::new(HostClock::start())).await;
    let error = closed.err().unwrap();
    assert!(error.to_string().contains("is not reachable") && error.remedy().contains("docs/"), "{error}");
}

#[test]
fn invalid_sampler_keys_are_refused_with_a_reason() {
    let read = |text: &str| toml::from_str::<SamplerConfig>(text).map_err(|error| error.to_string());
    assert!(read("tcp = \"127.0.0.1:5008\"\nperiod_s = 0.0005\naxes = [\"C\", \"X\"]").is_ok());
    for (keys, named) in [
        ("period_s = 1.0", "servo thread's period"),
        ("axes = [\"X\", \"X\"]", "each axis once"),
        ("axes = [\"X\", \"S\"]", "without S"),
        ("port = 5", "port"),
    ] {
        let error = read(&format!("tcp = \"127.0.0.1:5008\"\n{keys}")).unwrap_err();
        assert!(error.contains(named), "{error}");
    }
}
