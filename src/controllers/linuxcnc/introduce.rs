//! What it says of itself.

use super::driver::LinuxCnc;
use crate::controllers::{ControllerError, Introduction};

impl LinuxCnc {
    pub(super) async fn say_who(&mut self) -> Result<Introduction, ControllerError> {
        Ok(Introduction::default())
    }
}
