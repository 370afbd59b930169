//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main, setup};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main("RONt_*", "roundness deviation of section *"),
    main("R*", "form of section *"),
    setup("ecc_X*", "eccentricity of section *: X"),
    setup("ecc_Y*", "eccentricity of section *: Y"),
    setup("gain_multiprobe", "noise gain of the multiprobe method over the harmonics"),
    setup("gain_multistep", "noise gain of the multistep method over the harmonics"),
    setup("gain_combined", "noise gain of both methods together over the harmonics"),
    setup("gain_*", "sensor *: gain"),
    setup("angle_*", "sensor *: angle"),
    setup("stability_*", "sensor *: mean of each revolution"),
    main("residual_rms", "root mean square of the residuals"),
];
