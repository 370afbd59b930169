//! `trued token`: access from other computers to the page and its interface.

use std::path::Path;

use jiff::tz::TimeZone;

use super::Exit;
use super::args::{TokenArgs, TokenCommand};
use super::failure::Failure;
use super::files::state_folder;
use super::show::print_json;
use crate::service::Tokens;

pub fn token(args: &TokenArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let tokens = Tokens::beside(&state_folder(state)?);
    match &args.what {
        TokenCommand::Add { name, role } => {
            say!("{}", tokens.add(name, *role)?);
            tell!("keep it: it is shown this once. `trued token revoke {name}` makes it worthless");
        }
        TokenCommand::List { json } => list(&tokens, *json)?,
        TokenCommand::Revoke { name } => {
            tokens.revoke(name)?;
            tell!("{name} opens nothing any more");
        }
    }
    Ok(Exit::Pass)
}

fn list(tokens: &Tokens, json: bool) -> Result<(), Failure> {
    let all = tokens.all()?;
    if json {
        let public = |token: &crate::service::Token| serde_json::json!({"name": token.name, "role": token.role, "made": token.made});
        return print_json(&all.iter().map(public).collect::<Vec<_>>());
    }
    if all.is_empty() {
        tell!("no tokens; `trued token add NAME --role ROLE` makes one");
    }
    for token in all {
        let made = token.made.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M");
        say!("{:<40} {:<11} {made}", token.name, token.role);
    }
    Ok(())
}
