//! stub, to be replaced
pub mod circle;
pub mod coverage;
pub mod linear;
pub mod monte_carlo;
pub mod null_names;
#[cfg(test)]
mod tests;
pub mod trigonometric;
