//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[main("residuals", "residuals of the ball centres")];
