//! What it says of itself.

use super::driver::Grbl;
use crate::controllers::{ControllerError, Introduction};

impl Grbl {
    pub(super) async fn say_who(&mut self) -> Result<Introduction, ControllerError> {
        Ok(Introduction::default())
    }
}
