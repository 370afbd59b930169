//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main_result, setup_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    setup_result("e_x", "eccentricity of the plate: X"),
    setup_result("e_y", "eccentricity of the plate: Y"),
    setup_result("dz_dx", "inclination of the plate along X"),
    setup_result("dz_dy", "inclination of the plate along Y"),
    setup_result("plate_radial", "shape of the ball pattern: radial"),
    setup_result("plate_tangential", "shape of the ball pattern: tangential"),
    setup_result("plate_axial", "shape of the ball pattern: axial"),
    main_result("D*_revolutions", "deviation of the linear axes in *, each revolution"),
    main_result("DX", "deviation of the linear axes in X along the circle"),
    main_result("DY", "deviation of the linear axes in Y along the circle"),
    main_result("DZ", "deviation of the linear axes in Z along the circle"),
    main_result("residual_rms", "root mean square of the residuals"),
];
