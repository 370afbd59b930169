//! The definition of the command line: help for everything, and agreement with the README.

use std::collections::BTreeSet;

use clap::{Command, CommandFactory as _};

use super::args::Cli;

const README: &str = include_str!("../../README.md");

/// The program with the help that clap adds itself, and all commands below it.
fn all_commands() -> Vec<Command> {
    fn with_subcommands(command: &Command, all: &mut Vec<Command>) {
        all.push(command.clone());
        command.get_subcommands().for_each(|command| with_subcommands(command, all));
    }
    let mut program = Cli::command().disable_help_subcommand(true);
    program.build();
    let mut all = Vec::new();
    with_subcommands(&program, &mut all);
    all
}

#[test]
fn every_command_and_argument_has_help() {
    let mut without_help = Vec::new();
    for command in all_commands() {
        let name = command.get_bin_name().unwrap_or_default().to_owned();
        if command.get_about().is_none() {
            without_help.push(name.clone());
        }
        for argument in command.get_arguments().filter(|argument| argument.get_help().is_none()) {
            without_help.push(format!("{name}: {argument}"));
        }
    }
    assert!(without_help.is_empty(), "no help for\n{}", without_help.join("\n"));
}

#[test]
fn the_readme_lists_the_commands() {
    let visible = Cli::command();
    let visible = visible.get_subcommands().filter(|command| !command.is_hide_set());
    let defined: Vec<String> = visible.map(|command| format!("trued {}", command.get_name())).collect();
    let rows = README.lines().filter_map(|line| line.strip_prefix("| `")?.split_once("` |"));
    let listed: BTreeSet<&str> = rows.map(|(name, _)| name).filter(|name| name.starts_with("trued ")).collect();
    assert_eq!(listed, defined.iter().map(String::as_str).collect());
}

/// Options such as `--json` of each command in the list of the README; a line that begins with a blank continues
/// the line above.
fn options_in_readme(command: &str) -> BTreeSet<String> {
    let usage = README.split("\n```\n").find(|block| block.starts_with("trued run METHOD")).unwrap();
    let lines = usage.replace("\n ", " ");
    let of_command = lines.lines().filter(|line| *line == command || line.starts_with(&format!("{command} ")));
    let words = of_command.flat_map(|line| line.split(|letter: char| !letter.is_ascii_lowercase() && letter != '-'));
    words.filter(|word| word.starts_with("--")).map(str::to_owned).collect()
}

#[test]
fn the_readme_lists_the_options() {
    for command in all_commands().iter().filter(|command| !command.has_subcommands() && !command.is_hide_set()) {
        let own = command.get_arguments().filter(|argument| !argument.is_global_set());
        let defined: BTreeSet<String> = own
            .filter_map(|argument| Some(format!("--{}", argument.get_long()?)))
            .filter(|option| option != "--help")
            .collect();
        let name = command.get_bin_name().unwrap();
        assert_eq!(options_in_readme(name), defined, "{name}");
    }
}
