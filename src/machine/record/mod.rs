//! Floor 1: the nouns that travel between the rooms. They are data; nothing here acts.

pub mod artefact;
pub mod estimate;
pub mod event;
pub mod machine;
pub mod motion;
pub mod plan;
pub mod proof;
pub mod question;
pub mod reading;
pub mod sensor;
pub mod track;
