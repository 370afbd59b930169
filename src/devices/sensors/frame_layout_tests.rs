//! Tests of the layouts of sensor frames as a machine file states them, with bytes written by hand.

use serde::Deserialize;

use super::Sample;
use super::bit_field::Endianness;
use super::counter_tracker::CounterTracker;
use super::frame_layout::{
    FrameCounterKeys, FrameEncoderKeys, FrameLayout, FrameStatusKeys, FrameTooShort, FrameValueKeys,
};
use machine::record::reading::ReadingFlag;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TestLayoutKeys {
    order: Option<Endianness>,
    value: FrameValueKeys,
    counter: Option<FrameCounterKeys>,
    encoder_count: Option<FrameEncoderKeys>,
    #[serde(default)]
    status: Vec<FrameStatusKeys>,
}

/// Parses a layout of frames of 8 bytes.
fn parse_layout(toml: &str) -> Result<FrameLayout, String> {
    let keys: TestLayoutKeys = toml::from_str(toml).map_err(|error| error.message().to_owned())?;
    let TestLayoutKeys { order, value, counter, encoder_count, status } = keys;
    FrameLayout::new(value, counter, encoder_count, status, order, 8)
}

/// A layout, and the tracker of its counter.
struct TrackedLayout(FrameLayout, CounterTracker);

impl TrackedLayout {
    fn new(layout: FrameLayout) -> Self {
        let counting = CounterTracker::new(layout.sample_layout.counter_modulus());
        Self(layout, counting)
    }

    fn decode_sample(&mut self, t_s: f64, frame: &[u8]) -> Result<Sample, FrameTooShort> {
        Ok(self.1.complete_sample(t_s, self.0.decode(frame)?))
    }
}

const FULL_LAYOUT_KEYS: &str = r#"
order = "little"
value = { byte = 0, width = 24, signed = true, scale_mm = 1e-5, codes = [{ is = 8388607, means = "range" }] }
counter = { byte = 3, width = 8 }
[[status]]
byte = 4
bit = 0
means = "no-echo"
[[status]]
byte = 4
bit = 4
width = 4
is = 9
means = "saturated"
[[status]]
byte = 4
bit = 4
width = 4
is = 10
means = "stale"
"#;

/// A sample received at 1 s, without an encoder count.
fn expected_sample(value_mm: Option<f64>, flag: ReadingFlag, missing: u32) -> Sample {
    Sample { received_s: 1.0, value_mm, flag, lost_before_count: missing, encoder_count: None }
}

#[test]
fn frames_are_decoded_to_values_and_flags() {
    let mut follower = TrackedLayout::new(parse_layout(FULL_LAYOUT_KEYS).unwrap());
    let mut read = |frame: &[u8]| follower.decode_sample(1.0, frame).unwrap();
    // The most negative number of 24 bits: -8388608 counts of 10 nm.
    assert_eq!(read(&[0, 0, 0x80, 7, 0]), expected_sample(Some(-83.88608), ReadingFlag::None, 0));
    assert_eq!(read(&[0xFE, 0xFF, 0x7F, 8, 0]), expected_sample(Some(83.88606), ReadingFlag::None, 0));
    assert_eq!(read(&[0xFF, 0xFF, 0xFF, 9, 0]), expected_sample(Some(-1e-5), ReadingFlag::None, 0));
    // The code for a missing value; the same number could also be a value.
    assert_eq!(read(&[0xFF, 0xFF, 0x7F, 10, 0]), expected_sample(None, ReadingFlag::Range, 0));
    assert_eq!(read(&[0, 0, 0, 11, 1]), expected_sample(None, ReadingFlag::Range, 0));
    assert_eq!(read(&[0, 0, 0, 12, 0x90]), expected_sample(None, ReadingFlag::Saturated, 0));
    assert_eq!(read(&[0, 0, 0, 13, 0xA0]), expected_sample(None, ReadingFlag::Stale, 0));
    assert_eq!(read(&[0, 0, 0, 14, 0xB0]), expected_sample(Some(0.0), ReadingFlag::None, 0));
    let short = follower.decode_sample(1.0, &[0, 0, 0, 15]).unwrap_err();
    assert_eq!(short.to_string(), "the frame has 4 bytes, but the layout needs 5");
}

#[test]
fn counter_shows_missing_and_repeated_samples() {
    let mut follower = TrackedLayout::new(parse_layout(FULL_LAYOUT_KEYS).unwrap());
    let mut read = |count: u8| follower.decode_sample(1.0, &[1, 0, 0, count, 0]).unwrap();
    let one = Some(1e-5);
    assert_eq!(read(254), expected_sample(one, ReadingFlag::None, 0));
    assert_eq!(read(255), expected_sample(one, ReadingFlag::None, 0));
    assert_eq!(read(0), expected_sample(one, ReadingFlag::None, 0), "the counter wraps");
    assert_eq!(read(3), expected_sample(one, ReadingFlag::Gap, 2));
    assert_eq!(read(3), expected_sample(None, ReadingFlag::Stale, 0));
    assert_eq!(read(3), expected_sample(None, ReadingFlag::Stale, 0));
    assert_eq!(read(4), expected_sample(one, ReadingFlag::None, 0));
    assert_eq!(read(3), expected_sample(one, ReadingFlag::Gap, 254), "all but one round");
    follower.1.mark_data_lost();
    assert_eq!(follower.decode_sample(1.0, &[1, 0, 0, 3, 0]).unwrap(), expected_sample(one, ReadingFlag::Gap, 0));
    follower.1.ignore_next_gap();
    assert_eq!(follower.decode_sample(1.0, &[1, 0, 0, 99, 0]).unwrap(), expected_sample(one, ReadingFlag::None, 0));
    follower.1.ignore_next_gap();
    assert_eq!(follower.decode_sample(1.0, &[1, 0, 0, 99, 0]).unwrap(), expected_sample(None, ReadingFlag::Stale, 0));
}

#[test]
fn invalid_layout_keys_are_refused_with_a_reason() {
    let base = "order = \"big\"\n";
    let refused = [
        ("value = { byte = 0, width = 0, scale_mm = 1.0 }", "`value.width` is 0"),
        ("value = { byte = 0, width = 65, scale_mm = 1.0 }", "`value.width` is 65"),
        ("value = { byte = 0, width = 1, signed = true, scale_mm = 1.0 }", "a signed number has 2"),
        ("value = { byte = 0, bit = 8, width = 8, scale_mm = 1.0 }", "`value.bit` is 8"),
        ("value = { byte = 0, width = 16, scale_mm = 0.0 }", "`value.scale_mm` is 0"),
        ("value = { byte = 6, width = 24, scale_mm = 1.0 }", "`value` extends to byte 8"),
        ("value = { byte = 65535, width = 64, scale_mm = 1.0 }", "the frame has the 8 bytes 0 to 7"),
        ("value = { byte = 0, width = 65535, bit = 65535, scale_mm = 1.0 }", "`value.width` is 65535"),
        (
            "value = { byte = 0, width = 24, scale_mm = 1.0 }\ncounter = { byte = 2, width = 8 }",
            "`value` and `counter` overlap at byte 2, bit 0",
        ),
        (
            "value = { byte = 0, width = 12, scale_mm = 1.0 }\n[[status]]\nbyte = 0\nbit = 3\nmeans = \"range\"",
            "`value` and `status 1` overlap at byte 0, bit 3",
        ),
        (
            "value = { byte = 0, width = 8, scale_mm = 1.0 }\n[[status]]\nbyte = 1\nmeans = \"range\"\n\
             [[status]]\nbyte = 1\nis = 1\nmeans = \"stale\"",
            "`status 1` and `status 2` are met at the same time",
        ),
        (
            "value = { byte = 0, width = 8, scale_mm = 1.0 }\n[[status]]\nbyte = 1\nis = 1\n\
             means = \"range\"\n[[status]]\nbyte = 1\nis = 1\nmeans = \"stale\"",
            "`status 1` and `status 2` are met at the same time",
        ),
        (
            "value = { byte = 0, width = 8, scale_mm = 1.0 }\ncounter = { byte = 1, width = 33 }",
            "`counter.width` is 33",
        ),
        (
            "value = { byte = 0, width = 8, scale_mm = 1.0, codes = [{ is = 256, means = \"range\" }] }",
            "`value` can never be 256: 8 bits hold 0 to 255",
        ),
        ("value = { byte = \"first\", width = 8, scale_mm = 1.0 }", "invalid type: string \"first\""),
        ("value = { byte = 0, width = 8, scale = 1.0 }", "unknown field `scale`"),
    ];
    for (keys, why) in refused {
        let error = parse_layout(&format!("{base}{keys}")).unwrap_err();
        assert!(error.contains(why), "{keys}: {error}");
    }
    let error = parse_layout("value = { byte = 0, width = 16, scale_mm = 1.0 }").unwrap_err();
    assert_eq!(error, "`value` needs an `order`: `little` or `big`");
    parse_layout("value = { byte = 0, width = 8, scale_mm = 1.0 }").unwrap();
}

/// Encoder counts of 24 bits in both byte orders, and an encoder that restarts before its bits are exhausted.
#[test]
fn encoder_count_is_read_with_the_value() {
    let read = |encoder: &str, frame: &[u8]| {
        let value = "value = { byte = 0, width = 16, order = \"big\", scale_mm = 1e-3 }\n";
        let layout = parse_layout(&format!("{value}encoder_count = {{ byte = 2, {encoder} }}")).unwrap();
        (layout.sample_layout.encoder_modulus(), layout.decode(frame).unwrap().wrapped_encoder_count)
    };
    let frame = [0, 1, 0xFF, 0xFE, 0x01];
    let big = read("width = 24, order = \"big\"", &frame);
    assert_eq!(big, (Some(1 << 24), Some(0xFF_FE01)));
    assert_eq!(read("width = 24, order = \"little\"", &frame).1, Some(0x01_FEFF));
    let one_turn = read("width = 16, order = \"big\", round = 36000", &[0, 1, 0x8C, 0x9F]);
    assert_eq!(one_turn, (Some(36_000), Some(35_999)));
    assert_eq!(read("width = 32, order = \"big\"", &[0, 1, 0, 0, 1, 0]), (Some(1 << 32), Some(256)));
    let keys = "order = \"big\"\nvalue = { byte = 0, width = 16, scale_mm = 1e-3 }\n";
    for (encoder, words) in [
        ("byte = 1, width = 16", "`value` and `encoder_count` overlap at byte 1"),
        ("byte = 2, width = 16, round = 65537", "`encoder_count.round` is 65537"),
        ("byte = 7, width = 16", "`encoder_count` extends to byte 8"),
    ] {
        let why = parse_layout(&format!("{keys}encoder_count = {{ {encoder} }}")).unwrap_err();
        assert!(why.contains(words), "{why}");
    }
}
