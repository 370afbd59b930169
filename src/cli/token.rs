//! `trued token`: access from other computers to the web page and its interface.

use std::path::Path;

use jiff::tz::TimeZone;

use super::daemon_args::{TokenArgs, TokenCommand};
use super::failure::CommandFailure;
use super::files::state_folder;
use super::show::print_json;
use crate::service::TokenStore;

pub fn token_command(args: &TokenArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let tokens = TokenStore::in_folder(&state_folder(state)?);
    match &args.command {
        TokenCommand::Add { name, role } => {
            outln!("{}", tokens.add(name, *role)?);
            errln!(
                "Store this token safely: it cannot be printed again. To withdraw it, run `trued token revoke {name}`."
            );
        }
        TokenCommand::List { json } => list_tokens(&tokens, *json)?,
        TokenCommand::Revoke { name } => {
            tokens.revoke(name)?;
            errln!("the token {name} is revoked");
        }
    }
    Ok(())
}

fn list_tokens(tokens: &TokenStore, json: bool) -> Result<(), CommandFailure> {
    let all = tokens.read_all()?;
    if json {
        let public = |token: &crate::service::Token| serde_json::json!({"name": token.name, "role": token.role, "made": token.made});
        return print_json(&all.iter().map(public).collect::<Vec<_>>());
    }
    if all.is_empty() {
        errln!("no tokens; create one with `trued token add NAME --role ROLE`");
    }
    for token in all {
        let made = token.made.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M");
        outln!("{:<40} {:<11} {made}", token.name, token.role);
    }
    Ok(())
}
