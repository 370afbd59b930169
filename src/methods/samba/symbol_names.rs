//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[main_result("residuals", "residuals of the ball centres")];
