//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main_result, setup_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main_result("RONt_*", "roundness deviation of section *"),
    main_result("R*", "form of section *"),
    setup_result("ecc_X*", "eccentricity of section *: X"),
    setup_result("ecc_Y*", "eccentricity of section *: Y"),
    setup_result("gain_multiprobe", "noise gain of the multiprobe method over the harmonics"),
    setup_result("gain_multistep", "noise gain of the multistep method over the harmonics"),
    setup_result("gain_combined", "noise gain of both methods together over the harmonics"),
    setup_result("gain_*", "sensor *: gain"),
    setup_result("angle_*", "sensor *: angle"),
    setup_result("stability_*", "sensor *: mean of each revolution"),
    main_result("residual_rms", "root mean square of the residuals"),
];
