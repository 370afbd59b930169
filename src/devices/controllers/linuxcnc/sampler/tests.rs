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
fn halsampler(line: impl Fn(i64) -> Option<String> + Send + 'static) -> Config {
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
        thread::sleep(2 * ON_THE_WAY);
    });
    Config { tcp: HostPort::local(port), period_s: 0.001, axes: None }
}

fn stands(x: f64, c_deg: f64) -> Position {
    Position::new().with(Axis::X, x).with(Axis::C, c_deg.to_radians())
}

async fn opened(config: &Config) -> Sampler {
    Sampler::open(config, &AXES, Arc::new(HostClock::start())).await.unwrap()
}

fn good(tick: i64) -> Option<String> {
    Some(format!("{tick} 2.000000 90.000000 0 \n"))
}

async fn refused(config: &Config, stands: Position) -> String {
    let error = opened(config).await.agrees(&stands, &AXES, 1.0).await.unwrap_err();
    assert!(matches!(error, ControllerError::NotReady { .. }), "{error:?}");
    format!("{error}; {}", error.remedy())
}

#[tokio::test]
async fn what_agrees_is_kept_while_a_block_runs() {
    let mut sampler = opened(&halsampler(good)).await;
    sampler.agrees(&stands(50.8, 90.0), &AXES, 25.4).await.unwrap();
    sampler.begin();
    let begun_s = sampler.clock.now_s();
    sleep(Duration::from_millis(300)).await;
    let track = sampler.end(3, &stands(50.8, 90.0)).await.unwrap();
    assert_eq!(track.gaps(), 0);
    let at = track.at(begun_s + 0.15).unwrap();
    assert!((at.at(Axis::X) - 50.8).abs() < 1e-9 && at.get(Axis::S).is_none(), "{at:?}");
    assert!(track.positions() >= 300, "{}", track.positions());
    let elsewhere = sampler.end(4, &stands(50.8, 88.0)).await.unwrap_err();
    let said = format!("{elsewhere}; {}", elsewhere.remedy());
    assert!(said.contains("step 4") && said.contains("C stands at 88.000"), "{said}");
}

#[tokio::test]
async fn wrong_pins_units_and_lines_are_refused_before_anything_moves() {
    let swapped = refused(&halsampler(good), stands(90.0, 2.0)).await;
    assert!(
        swapped.contains("X stands at 90.000") && swapped.contains("joint.N.pos-fb"),
        "{swapped}"
    );
    // Lines without the bit.
    let config = halsampler(|tick| Some(format!("{tick} 2.0 90.0 \n")));
    let other = refused(&config, stands(2.0, 90.0)).await;
    assert!(other.contains("it says `") && other.contains("2 positions and a bit"), "{other}");
    let few = Config { axes: Some(vec![Axis::X]), ..halsampler(good) };
    let few = refused(&few, stands(2.0, 90.0)).await;
    assert!(few.contains("does not take down axis C"), "{few}");
    let slow = Config { period_s: 0.002, ..halsampler(good) };
    let slow = refused(&slow, stands(2.0, 90.0)).await;
    assert!(slow.contains("period_s"), "{slow}");
}

#[tokio::test]
async fn one_that_falls_silent_or_is_lost_ends_the_scan() {
    let silent = Arc::new(AtomicBool::new(false));
    let known = silent.clone();
    let quiet = halsampler(move |tick| if known.load(SeqCst) { None } else { good(tick) });
    let mut sampler = opened(&quiet).await;
    sampler.agrees(&stands(2.0, 90.0), &AXES, 1.0).await.unwrap();
    sampler.begin();
    silent.store(true, SeqCst);
    sleep(Duration::from_millis(700)).await;
    let error = sampler.end(5, &stands(2.0, 90.0)).await.unwrap_err();
    assert!(matches!(error, ControllerError::Unstamped { step: 5, .. }), "{error:?}");
    assert!(error.to_string().contains("nothing new"), "{error}");
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let nobody = Config { tcp: HostPort::local(free), period_s: 0.001, axes: None };
    let closed = Sampler::open(&nobody, &AXES, Arc::new(HostClock::start())).await;
    let error = closed.err().unwrap();
    assert!(
        error.to_string().contains("is not there") && error.remedy().contains("docs/"),
        "{error}"
    );
}

#[test]
fn its_table_is_looked_at() {
    let read = |text: &str| toml::from_str::<Config>(text).map_err(|error| error.to_string());
    assert!(read("tcp = \"127.0.0.1:5008\"\nperiod_s = 0.0005\naxes = [\"C\", \"X\"]").is_ok());
    for (keys, named) in [
        ("period_s = 1.0", "servo thread's period"),
        ("axes = [\"X\", \"X\"]", "each axis once"),
        ("axes = [\"X\", \"S\"]", "S is none"),
        ("port = 5", "port"),
    ] {
        let error = read(&format!("tcp = \"127.0.0.1:5008\"\n{keys}")).unwrap_err();
        assert!(error.contains(named), "{error}");
    }
}
