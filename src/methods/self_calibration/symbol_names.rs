//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main("X_*", "location of * in X, machine coordinates"),
    main("Y_*", "location of * in Y, machine coordinates"),
    main("E_radial_XY", "radial displacement of X and Y on a circle"),
    main("W_radial", "radius of the part over its angle, with eccentricity"),
    main("W_form", "form of the part"),
];
