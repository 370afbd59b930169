//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main_result("X_*", "location of * in X, machine coordinates"),
    main_result("Y_*", "location of * in Y, machine coordinates"),
    main_result("E_radial_XY", "radial displacement of X and Y on a circle"),
    main_result("W_radial", "radius of the part over its angle, with eccentricity"),
    main_result("W_form", "form of the part"),
];
