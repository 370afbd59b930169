//! Sensors of a step in JSON: `"sensor": "probe"`, or `"sensors": ["x1", "y1"]` for several; an empty string means
//! none. Either key is accepted.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum SensorNames {
    One(String),
    Many(Vec<String>),
}

#[derive(Serialize, Deserialize)]
struct SensorNamesKeys {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensor: Option<SensorNames>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensors: Option<Vec<String>>,
}

/// Writes `sensor` for one name (an empty string for none), `sensors` for several.
pub fn serialize<S: Serializer>(names: &[String], serializer: S) -> Result<S::Ok, S::Error> {
    let single = |name: String| SensorNamesKeys { sensor: Some(SensorNames::One(name)), sensors: None };
    let keys = match names {
        [] => single(String::new()),
        [name] => single(name.clone()),
        names => SensorNamesKeys { sensor: None, sensors: Some(names.to_vec()) },
    };
    keys.serialize(serializer)
}

/// Reads the names. If both keys are present, `sensors` counts; `sensor` may also be a list.
///
/// # Errors
/// The keys `sensor` and `sensors` are both missing.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    match SensorNamesKeys::deserialize(deserializer)? {
        SensorNamesKeys { sensors: Some(names), .. } => Ok(names),
        SensorNamesKeys { sensor: Some(SensorNames::One(name)), .. } if name.is_empty() => Ok(Vec::new()),
        SensorNamesKeys { sensor: Some(SensorNames::One(name)), .. } => Ok(vec![name]),
        SensorNamesKeys { sensor: Some(SensorNames::Many(names)), .. } => Ok(names),
        SensorNamesKeys { .. } => Err(serde::de::Error::missing_field("sensor")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Step {
        #[serde(flatten, with = "super")]
        names: Vec<String>,
    }

    #[test]
    fn sensor_names_round_trip_through_json() {
        let cases: [(&str, &[&str]); 3] = [
            (r#"{"sensor":""}"#, &[]),
            (r#"{"sensor":"laser"}"#, &["laser"]),
            (r#"{"sensors":["x","y"]}"#, &["x", "y"]),
        ];
        for (json, names) in cases {
            let step: Step = serde_json::from_str(json).unwrap();
            assert_eq!(step.names, names);
            assert_eq!(serde_json::to_string(&step).unwrap(), json);
        }
        for (json, names) in [(r#"{"sensor":["x","y"]}"#, ["x", "y"].as_slice()), (r#"{"sensors":["x"]}"#, &["x"])] {
            assert_eq!(serde_json::from_str::<Step>(json).unwrap().names, names);
        }
        assert!(serde_json::from_str::<Step>("{}").is_err());
    }
}
