//! Dialects: folders in `gcode-templates/`, embedded into the program.

use include_dir::{Dir, include_dir};
use minijinja::Environment;
use serde::Deserialize;

use super::error::{DialectError, RenderError};
use super::options::Options;
use super::render;
use machine::Axis;
use machine::record::motion::Block;

static TEMPLATES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../../gcode-templates");

/// The languages that have a reader.
const LANGUAGES: [&str; 1] = ["rs274"];

/// `dialect.toml`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Spec {
    pub name: String,
    pub language: String,
    /// How a file's name ends, without the dot.
    pub extension: String,
    pub decimals_mm: usize,
    pub decimals_deg: usize,
    /// Axes that have a word.
    pub axes: Vec<Axis>,
    /// The slot in which the programs work: there, work coordinates are machine coordinates.
    pub work_offset: String,
    #[serde(default)]
    pub inputs: Inputs,
}

/// How a control names inputs that the machine file may refer to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Inputs {
    #[default]
    None,
    Numbers,
    Letters,
}

/// One way of writing programs: words, decimals and a template for each neutral motion. A motion
/// without a template is one that the control cannot do.
#[derive(Debug, Clone)]
pub struct Dialect {
    pub(super) spec: Spec,
    pub(super) templates: Environment<'static>,
    pub(super) options: Options,
}

/// What head and foot need to know.
#[derive(Debug, Clone, Copy)]
pub struct Program<'a> {
    /// A comment for the person who reads the program.
    pub title: &'a str,
    /// The machine's axes.
    pub axes: &'a [Axis],
    /// Absolute path of the file that takes the results, where the control writes one itself.
    pub log: Option<&'a str>,
}

impl Dialect {
    /// The dialect of this name.
    ///
    /// # Errors
    /// An unknown name (the error lists the known ones) or a folder that is not whole.
    pub fn named(name: &str) -> Result<Self, DialectError> {
        let folder = TEMPLATES
            .get_dir(name)
            .ok_or_else(|| DialectError::Unknown { name: name.to_owned(), known: Self::names() })?;
        Self::load(folder)
            .map_err(|why| DialectError::Broken { folder: name.to_owned(), why: why.to_string() })
    }

    fn names() -> Vec<String> {
        let mut names: Vec<_> =
            TEMPLATES.dirs().map(|dir| dir.path().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    fn load(folder: &'static Dir<'static>) -> Result<Self, Box<dyn std::error::Error>> {
        let text = |path: &std::path::Path| {
            folder.get_file(path).and_then(|file| file.contents_utf8()).unwrap_or_default()
        };
        let spec: Spec = toml::from_str(text(&folder.path().join("dialect.toml")))?;
        if !LANGUAGES.contains(&spec.language.as_str()) {
            return Err(format!("unknown language `{}`", spec.language).into());
        }
        let mut templates = render::environment();
        for file in folder.files() {
            if file.path().extension().is_some_and(|extension| extension == "j2") {
                let name = file.path().file_stem().unwrap_or_default().to_string_lossy();
                templates.add_template_owned(name.into_owned(), text(file.path()))?;
            }
        }
        Ok(Self { spec, templates, options: Options::default() })
    }

    pub fn name(&self) -> &str {
        &self.spec.name
    }

    /// How a program's file name ends, without the dot.
    pub fn extension(&self) -> &str {
        &self.spec.extension
    }

    /// The lines that set all modal state.
    pub fn head(&self, program: &Program) -> Result<Vec<String>, RenderError> {
        render::frame(self, "head", program)
    }

    /// The lines that restore what the head changed, as far as the language allows.
    pub fn foot(&self, program: &Program) -> Result<Vec<String>, RenderError> {
        render::frame(self, "foot", program)
    }

    /// The lines of one block; the N words carry the step's id.
    ///
    /// # Errors
    /// A value that is not finite, an axis without a word, a motion that the control cannot do.
    pub fn block(&self, block: &Block) -> Result<Vec<String>, RenderError> {
        render::block(self, block)
    }

    /// The lines that show `text` to a person and wait until somebody starts the program again.
    ///
    /// # Errors
    /// A control that cannot wait so.
    pub fn ask(&self, step: u32, text: &str) -> Result<Vec<String>, RenderError> {
        render::ask(self, step, text)
    }

    /// A whole program: head, blocks, foot; each line ends with a newline.
    pub fn program(&self, program: &Program, blocks: &[Block]) -> Result<String, RenderError> {
        let mut lines = self.head(program)?;
        for block in blocks {
            lines.extend(self.block(block)?);
        }
        lines.extend(self.foot(program)?);
        Ok(lines.into_iter().map(|line| line + "\n").collect())
    }
}
