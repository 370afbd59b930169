//! The templates are embedded: a new template file must rebuild the crate.

fn main() {
    println!("cargo::rerun-if-changed=../../gcode-templates");
}
