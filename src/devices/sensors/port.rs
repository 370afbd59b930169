//! Port that several sensors name, and the keys that must be equal for them.

/// A serial port or a converter, as one sensor's table states it.
#[derive(Debug)]
pub struct SharedPort {
    /// Name of the port, as in the table.
    pub name: String,
    /// Keys and values that must be the same for all sensors of the port, the kind of table first.
    pub shared_keys: Vec<(&'static str, String)>,
}

impl SharedPort {
    /// Describes how this port differs from that of the sensor `owner`; `None` if it is another port, or if
    /// both can share it.
    pub fn describe_conflict(&self, owner: &str, other: &Self) -> Option<String> {
        if self.name != other.name {
            return None;
        }
        let mut pairs = self.shared_keys.iter().zip(&other.shared_keys);
        let ((key, own), (_, others)) = pairs.find(|(own, others)| own != others)?;
        Some(format!(
            "shares the port {} with `{owner}`, but {key} is {own} here and {others} there: set the same value \
             for all sensors of a port",
            self.name
        ))
    }
}
