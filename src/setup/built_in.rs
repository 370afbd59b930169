//! Built-in machine files, one for each method.

use include_dir::{Dir, include_dir};

use super::machine_file::{MachineFile, MachineFileError};

static CONFIG_FOLDER: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/config");

impl MachineFile {
    /// The built-in machine file for the method `method_name`, or for the first method if the name is unknown.
    pub fn built_in_for_method(method_name: &str) -> Result<Self, MachineFileError> {
        let method = methods::method_description(method_name).or(methods::METHOD_DESCRIPTIONS.first());
        let file = method.map_or("", |method| method.default_machine_file);
        let text = CONFIG_FOLDER.get_file(file).and_then(|file| file.contents_utf8()).unwrap_or_default();
        Self::parse(&format!("{file} (built in)"), text.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use crate::setup;

    #[test]
    fn each_method_has_a_plan_on_its_built_in_machine() {
        for method in methods::METHOD_DESCRIPTIONS {
            let file = setup::load_machine_file(None, method.name).unwrap();
            let (_, plan_without_steps) =
                setup::configure_method_and_plan_without_steps(&file, method.name, None).unwrap();
            assert_eq!(plan_without_steps.method, method.name);
        }
    }
}
