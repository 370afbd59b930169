//! A port that several sensors name: which keys they must have alike.

/// A serial port or a converter, as one sensor's table states it.
#[derive(Debug)]
pub struct Port {
    /// As the table names it.
    pub name: String,
    /// What must be the same for all sensors of the port: key and value, the kind of table first.
    pub keys: Vec<(&'static str, String)>,
}

impl Port {
    /// How it differs from that of the sensor `owner`, in words; `None`: it is another port, or both can share it.
    pub fn conflict(&self, owner: &str, other: &Self) -> Option<String> {
        if self.name != other.name {
            return None;
        }
        let mut pairs = self.keys.iter().zip(&other.keys);
        let ((key, own), (_, others)) = pairs.find(|(own, others)| own != others)?;
        Some(format!(
            "is on the same port as `{owner}` ({}), but {key} is {own} here and {others} there: sensors that \
             share a port must have it alike",
            self.name
        ))
    }
}
