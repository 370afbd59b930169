//! Port that several sensors share, and the keys that must be equal in their tables.

/// A serial port or a converter, as one sensor's table states it.
#[derive(Debug)]
pub struct SharedPort {
    /// Name of the port, as in the table.
    pub name: String,
    /// Keys and values that must be the same for all sensors of the port. The first one is the name of the table.
    pub keys_required_equal: Vec<(&'static str, String)>,
}

impl SharedPort {
    /// Describes how this port differs from that of the sensor `owner`; `None` if the ports are not the same port, or
    /// if both sensors can share it.
    pub fn describe_conflict(&self, owner: &str, other: &Self) -> Option<String> {
        if self.name != other.name {
            return None;
        }
        let mut pairs = self.keys_required_equal.iter().zip(&other.keys_required_equal);
        let ((key, own), (_, others)) = pairs.find(|(own, others)| own != others)?;
        Some(format!(
            "shares the port {} with `{owner}`, but {key} is {own} here and {others} there: set the same value \
             for all sensors of a port",
            self.name
        ))
    }
}
