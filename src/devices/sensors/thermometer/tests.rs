//! Tests of the thermometers in a machine file, and of the validity of their values.

use std::time::Duration;

use super::{
    SimulatedTemperatureSource, ThermometerConfig, ThermometerError, ThermometerPoller, group_by_device,
    read_thermometers_once,
};

const MODBUS_THERMOMETER_KEYS: &str = r#"
name = "spindle"
stale_s = 10
[modbus]
tcp = "127.0.0.1:9"
value = { register = 4, type = "i16", scale_c = 0.1, offset_c = -10 }
"#;

fn parse_thermometer(text: &str) -> Result<ThermometerConfig, String> {
    toml::from_str(text).map_err(|error: toml::de::Error| error.to_string())
}

fn simulated_thermometer(name: &str) -> ThermometerConfig {
    parse_thermometer(&format!("name = \"{name}\"\n[simulated]")).unwrap()
}

#[test]
fn invalid_thermometer_keys_are_refused_with_a_reason() {
    let made = parse_thermometer(MODBUS_THERMOMETER_KEYS).unwrap();
    assert_eq!((made.max_age, made.describe_address()), (Duration::from_secs(10), "127.0.0.1:9, unit 255".to_owned()));
    let cases = [
        ("name = \"spindle\"", "name = \"spindle nose\"", "letters, digits and hyphens"),
        ("name = \"spindle\"", "name = \"\"", "letters, digits and hyphens"),
        ("stale_s = 10", "stale_s = 0", "`stale_s` is 0"),
        ("stale_s = 10", "stales = 10", "unknown field `stales`"),
        ("scale_c = 0.1", "scale_c = 0", "`value.scale_c` is 0"),
        ("scale_c = 0.1", "scale_mm = 0.1", "unknown field `scale_mm`"),
        ("register = 4, type = \"i16\"", "register = 65535, type = \"f32\"", "beyond register 65535"),
        ("[modbus]", "[simulated]\n[modbus]", "exactly one of"),
        ("[modbus]\n", "[modbus]\nspace = \"coil\"\n", "a bit cannot hold a temperature"),
        ("[modbus]\n", "[modbus]\nbaud = 9600\n", "baud"),
    ];
    for (from, to, words) in cases {
        assert!(MODBUS_THERMOMETER_KEYS.contains(from), "{from}");
        let refused = parse_thermometer(&MODBUS_THERMOMETER_KEYS.replacen(from, to, 1)).unwrap_err();
        assert!(refused.contains(words), "{to}: {refused}");
    }
    assert!(parse_thermometer("name = \"spindle\"").unwrap_err().contains("exactly one of"));
}

#[test]
fn thermometers_are_grouped_by_device() {
    let of = |from: &str, to: &str| parse_thermometer(&MODBUS_THERMOMETER_KEYS.replacen(from, to, 1)).unwrap();
    let entries = [
        of("", ""),
        of("register = 4", "register = 5"),
        of("[modbus]\n", "[modbus]\nunit = 3\n"),
        simulated_thermometer("bed"),
    ];
    let counts: Vec<_> = group_by_device(&entries).values().map(Vec::len).collect();
    assert_eq!(counts, [2, 1]);
}

fn constant_temperature_source(celsius: Option<f64>) -> impl Fn(&str) -> Option<SimulatedTemperatureSource> {
    move |_| Some(Box::new(move || celsius))
}

/// Plausible are -40 to 80 °C: a value beyond this range is an error that states the value.
#[tokio::test]
async fn implausible_temperature_is_an_error() {
    let entries = [simulated_thermometer("bed")];
    for (celsius, good) in [(-40.0, true), (80.0, true), (80.1, false), (-200.0, false)] {
        let values = read_thermometers_once(&entries, constant_temperature_source(Some(celsius))).await;
        assert_eq!(values[0].1.is_ok(), good, "{celsius}");
        let now = ThermometerPoller::start(&entries, constant_temperature_source(Some(celsius)));
        assert_eq!(now.current_temperatures_c()[0].1.is_ok(), good, "{celsius}");
    }
    let error =
        read_thermometers_once(&entries, constant_temperature_source(Some(850.0))).await.remove(0).1.unwrap_err();
    assert!(error.to_string().contains("850.0 °C") && error.remedy().contains("broken wire"));
    let nothing = read_thermometers_once(&entries, |_| None).await.remove(0).1;
    assert!(matches!(nothing, Err(ThermometerError::NoSimulatedMachine)));
}
