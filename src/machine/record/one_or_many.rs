//! A list of names in JSON: one as a string, several as a list, none as an empty string.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Names {
    One(String),
    Many(Vec<String>),
}

pub fn serialize<S: Serializer>(names: &[String], serializer: S) -> Result<S::Ok, S::Error> {
    let json = match names {
        [] => Names::One(String::new()),
        [name] => Names::One(name.clone()),
        names => Names::Many(names.to_vec()),
    };
    json.serialize(serializer)
}

pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    Ok(match Names::deserialize(deserializer)? {
        Names::One(name) if name.is_empty() => Vec::new(),
        Names::One(name) => vec![name],
        Names::Many(names) => names,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Held(#[serde(with = "super")] Vec<String>);

    #[test]
    fn names_come_back_from_their_json() {
        let cases: [(&str, &[&str]); 3] =
            [(r#""""#, &[]), (r#""laser""#, &["laser"]), (r#"["x","y"]"#, &["x", "y"])];
        for (json, names) in cases {
            let held: Held = serde_json::from_str(json).unwrap();
            assert_eq!(held.0, names);
            assert_eq!(serde_json::to_string(&held).unwrap(), json);
        }
    }
}
