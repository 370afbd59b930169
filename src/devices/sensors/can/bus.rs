//! What is known of the bus while no frame comes: why that may be.

use link::can::{CanError, Heard, Id};

#[derive(Debug, Default)]
pub(super) struct Bus {
    down: Option<String>,
    /// Its controller has left it.
    off: Option<String>,
    /// What it said last of its errors.
    errors: Option<String>,
    /// Whose frames come instead.
    others: Vec<Id>,
}

impl Bus {
    /// Whatever is no frame.
    pub fn hears(&mut self, heard: Heard) {
        match heard {
            Heard::Frame(_) => {}
            Heard::Down(why) => self.down = Some(why),
            Heard::Up => (self.down, self.off) = (None, None),
            Heard::Off(why) => self.off = Some(why),
            Heard::Lost(_) => self.off = None,
            Heard::Trouble(why) => self.errors = Some(why),
            Heard::Other(id) => self.others.push(id),
        }
    }

    /// A frame came: all that was said before is over.
    pub fn speaks(&mut self) {
        *self = Self::default();
    }

    /// What is the matter with it, if it says; what explains most comes first.
    pub fn ails(&self, interface: &str, id: Id) -> Option<CanError> {
        let (interface, id) = (interface.to_owned(), id.to_string());
        if let Some(why) = self.down.clone() {
            return Some(CanError::Down { interface, why });
        }
        if let Some(why) = self.off.clone() {
            return Some(CanError::Off { interface, why });
        }
        // Who hears the frames of others understands the bus.
        if !self.others.is_empty() {
            let others = self.others.iter().map(Id::to_string).collect::<Vec<_>>().join(", ");
            return Some(CanError::Others { interface, id, others });
        }
        let why = self.errors.clone()?;
        Some(CanError::Trouble { interface, id, why })
    }
}
