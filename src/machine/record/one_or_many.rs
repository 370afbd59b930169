//! Sensors of a step in JSON: `"sensor": "probe"`, or `"sensors": ["x1", "y1"]` for several; an empty string means
//! none. Either key is accepted.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Names {
    One(String),
    Many(Vec<String>),
}

#[derive(Serialize, Deserialize)]
struct Keys {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensor: Option<Names>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensors: Option<Vec<String>>,
}

pub fn serialize<S: Serializer>(names: &[String], serializer: S) -> Result<S::Ok, S::Error> {
    let one = |name: String| Keys { sensor: Some(Names::One(name)), sensors: None };
    let keys = match names {
        [] => one(String::new()),
        [name] => one(name.clone()),
        names => Keys { sensor: None, sensors: Some(names.to_vec()) },
    };
    keys.serialize(serializer)
}

/// # Errors
/// Both keys are missing.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    match Keys::deserialize(deserializer)? {
        Keys { sensors: Some(names), .. } => Ok(names),
        Keys { sensor: Some(Names::One(name)), .. } if name.is_empty() => Ok(Vec::new()),
        Keys { sensor: Some(Names::One(name)), .. } => Ok(vec![name]),
        Keys { sensor: Some(Names::Many(names)), .. } => Ok(names),
        Keys { .. } => Err(serde::de::Error::missing_field("sensor")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Held {
        #[serde(flatten, with = "super")]
        names: Vec<String>,
    }

    #[test]
    fn names_come_back_from_their_json() {
        let cases: [(&str, &[&str]); 3] = [
            (r#"{"sensor":""}"#, &[]),
            (r#"{"sensor":"laser"}"#, &["laser"]),
            (r#"{"sensors":["x","y"]}"#, &["x", "y"]),
        ];
        for (json, names) in cases {
            let held: Held = serde_json::from_str(json).unwrap();
            assert_eq!(held.names, names);
            assert_eq!(serde_json::to_string(&held).unwrap(), json);
        }
        for (json, names) in
            [(r#"{"sensor":["x","y"]}"#, ["x", "y"].as_slice()), (r#"{"sensors":["x"]}"#, &["x"])]
        {
            assert_eq!(serde_json::from_str::<Held>(json).unwrap().names, names);
        }
        assert!(serde_json::from_str::<Held>("{}").is_err());
    }
}
