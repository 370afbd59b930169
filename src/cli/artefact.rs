//! `trued artefact`: the register of calibrated artefacts and check standards.

use std::path::Path;

use clap::{Args, Subcommand};
use jiff::Zoned;
use jiff::civil::Date;
use serde_json::json;

use super::failure::CommandFailure;
use super::files::state_folder;
use super::show::print_json;
use crate::store::{ArtefactRegister, ArtefactRegisterError, RegisteredArtefact, state_dir};
use machine::record::report_data::ReportData;

#[derive(Debug, Args)]
pub struct ArtefactArgs {
    #[command(subcommand)]
    pub command: ArtefactCommand,
}

#[derive(Debug, Subcommand)]
pub enum ArtefactCommand {
    /// Add an artefact, or enter the new certificate of an artefact that was calibrated again.
    Add {
        /// Name of the artefact, as in `[report] artefact` of the machine file.
        name: String,
        /// Number of the calibration certificate, and the laboratory.
        #[arg(long, value_name = "TEXT")]
        certificate: String,
        /// Last day on which the certificate is valid.
        #[arg(long, value_name = "YYYY-MM-DD", value_parser = parse_date)]
        due: Date,
        /// Kind of the artefact, e.g. `cylinder 90 mm`. Without this option a new certificate keeps the kind.
        #[arg(long, value_name = "TEXT")]
        kind: Option<String>,
    },
    /// List the artefacts with the state of their certificates: valid, due within 30 days, or expired.
    List {
        /// Print the list as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Remove an artefact. Runs that were measured with it keep its certificate.
    Remove {
        /// Name of the artefact; `trued artefact list` lists the names.
        name: String,
    },
}

fn parse_date(text: &str) -> Result<Date, String> {
    Date::strptime("%Y-%m-%d", text).map_err(|_| "the value is not a date of the form YYYY-MM-DD".to_owned())
}

pub fn artefact_command(args: &ArtefactArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let register = ArtefactRegister::in_folder(&state_folder(state)?);
    let today = Zoned::now().date();
    match &args.command {
        ArtefactCommand::Add { name, certificate, due, kind } => {
            let (name, certificate) = (name.clone(), certificate.clone());
            let artefact = RegisteredArtefact { name, kind: kind.clone(), certificate, due: *due };
            let replaced = register.add(artefact.clone())?;
            if let Some(RegisteredArtefact { certificate, due, .. }) = replaced {
                errln!("replaced: certificate {certificate}, valid until {due}");
            }
            errln!("the certificate of {} is {}", artefact.name, artefact.certificate_state(today).label());
        }
        ArtefactCommand::List { json: true } => {
            let entries = register.read_all()?.into_iter().map(|artefact| list_entry(&artefact, today));
            print_json(&entries.collect::<Vec<_>>())?;
        }
        ArtefactCommand::List { json: false } => print_artefacts(&register.read_all()?, today),
        ArtefactCommand::Remove { name } => {
            register.remove(name)?;
            errln!("the artefact {name} is removed; state its certificate in [report] of the machine file");
        }
    }
    Ok(())
}

fn list_entry(artefact: &RegisteredArtefact, today: Date) -> serde_json::Value {
    let RegisteredArtefact { name, kind, certificate, due } = artefact;
    let state = artefact.certificate_state(today);
    json!({"name": name, "kind": kind, "certificate": certificate, "due": due, "state": state})
}

fn print_artefacts(artefacts: &[RegisteredArtefact], today: Date) {
    if artefacts.is_empty() {
        errln!("no artefacts; add one with `trued artefact add NAME --certificate TEXT --due YYYY-MM-DD`");
    }
    for artefact in artefacts {
        let state = artefact.certificate_state(today);
        let kind = artefact.kind.as_ref().map_or(String::new(), |kind| format!(" ({kind})"));
        outln!(
            "{:<18}  {}  {}{kind}, certificate {}",
            state.label(),
            artefact.due,
            artefact.name,
            artefact.certificate
        );
    }
}

/// Report data of the machine file, completed with the certificate of a registered artefact. Without a known state
/// folder there is no register.
///
/// # Errors
/// Both the machine file and the register state a certificate of the artefact, or the register cannot be read.
pub fn complete_report_data(stated: &ReportData, state: Option<&Path>) -> Result<ReportData, ArtefactRegisterError> {
    match state_dir(state) {
        Some(folder) => ArtefactRegister::in_folder(&folder).complete_report_data(stated),
        None => Ok(stated.clone()),
    }
}
