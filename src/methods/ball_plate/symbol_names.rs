//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main, setup};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    setup("e_x", "eccentricity of the plate: X"),
    setup("e_y", "eccentricity of the plate: Y"),
    setup("dz_dx", "inclination of the plate along X"),
    setup("dz_dy", "inclination of the plate along Y"),
    setup("plate_radial", "shape of the ball pattern: radial"),
    setup("plate_tangential", "shape of the ball pattern: tangential"),
    setup("plate_axial", "shape of the ball pattern: axial"),
    main("D*_revolutions", "deviation of the linear axes in *, each revolution"),
    main("DX", "deviation of the linear axes in X along the circle"),
    main("DY", "deviation of the linear axes in Y along the circle"),
    main("DZ", "deviation of the linear axes in Z along the circle"),
    main("residual_rms", "root mean square of the residuals"),
];
