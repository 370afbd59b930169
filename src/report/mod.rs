//! Floor 5: files and pages for people and programs; knows kinds of figure, never methods.

pub mod readings_csv;
