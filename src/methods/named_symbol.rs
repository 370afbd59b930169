//! The name of a result in plain words, and the group in which it is displayed.

use crate::prediction::VOLUMETRIC_ERROR_SYMBOL;
use crate::registry::method_description;
use crate::symbol_names::{
    NamedSymbol, ResultGroup, SymbolPattern, harmonic_result, main_result, name_by_pattern, setup_result,
};
use machine::geometric_error_name;

/// Patterns of the part of a symbol after its first `_`: `EXC_range` is the range of the error motion EXC.
const SUFFIX_NAMES: &[SymbolPattern] = &[
    main_result("range", "range over one revolution"),
    main_result("synchronous", "synchronous value (mean of all revolutions)"),
    main_result("asynchronous", "asynchronous value (spread between revolutions)"),
    main_result("total", "with the effect of its location errors"),
    main_result("fundamental", "fundamental value (first harmonic)"),
    main_result("residual_synchronous", "residual synchronous value (without the first harmonic)"),
    main_result("reversal", "difference between the two senses of rotation"),
    main_result("lsc", "by the least-squares circle (ISO 230-7), not by the mean"),
    main_result("spectrum", "amplitudes of the harmonics"),
    main_result("stops", "values at the stops"),
    harmonic_result("cos*", "harmonic *, cosine part"),
    harmonic_result("sin*", "harmonic *, sine part"),
    harmonic_result("c*", "harmonic *, cosine part"),
    harmonic_result("s*", "harmonic *, sine part"),
];

/// Results of several methods.
const COMMON_SYMBOLS: &[SymbolPattern] = &[
    main_result(VOLUMETRIC_ERROR_SYMBOL, "largest position error of the tool over the measured volume"),
    setup_result("tool_x", "stylus tip: X"),
    setup_result("tool_y", "stylus tip: Y"),
    setup_result("tool_z", "stylus tip: Z"),
    setup_result("ball_*_x", "ball *: X"),
    setup_result("ball_*_y", "ball *: Y"),
    setup_result("ball_*_z", "ball *: Z"),
];

/// Name of `symbol` in an estimate or a figure of `method`. `None`: no pattern matches, as for a symbol that is
/// already plain text.
pub fn named_symbol(method: &str, symbol: &str) -> Option<NamedSymbol> {
    if let Some((own, height_mm)) = symbol.split_once("@Z") {
        let NamedSymbol { name, group } = named_symbol(method, own)?;
        return Some(NamedSymbol { name: format!("{name}, at Z = {height_mm} mm"), group });
    }
    if let Some(name) = geometric_error_name(symbol) {
        return Some(NamedSymbol { name, group: ResultGroup::Main });
    }
    let own_patterns = method_description(method).map_or(&[][..], |description| description.symbol_names);
    name_by_pattern(own_patterns, symbol).or_else(|| name_by_pattern(COMMON_SYMBOLS, symbol)).or_else(|| {
        let (error, suffix) = symbol.split_once('_')?;
        let NamedSymbol { name, group } = name_by_pattern(SUFFIX_NAMES, suffix)?;
        Some(NamedSymbol { name: format!("{}: {name}", geometric_error_name(error)?), group })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_have_names_and_groups() {
        for (method, symbol, name, group) in [
            ("samba", "EA0B", "orientation of B about X", ResultGroup::Main),
            ("samba", "ball_12_x", "ball 12: X", ResultGroup::Setup),
            ("ball-plate", "EXC_c8", "error motion of C in X: harmonic 8, cosine part", ResultGroup::Harmonics),
            (
                "self-calibration",
                "EXC_total@Z50.0",
                "error motion of C in X: with the effect of its location errors, at Z = 50.0 mm",
                ResultGroup::Main,
            ),
            ("multiprobe", "gain_r1", "sensor r1: gain", ResultGroup::Setup),
        ] {
            let named = named_symbol(method, symbol);
            assert_eq!(named, Some(NamedSymbol { name: name.to_owned(), group }), "{symbol}");
        }
        assert_eq!(named_symbol("samba", "axis of C"), None);
    }
}
