//! Roles, and the role that each route requires.

use std::fmt;
use std::str::FromStr;

use serde::de::IntoDeserializer;
use serde::de::value::Error as ValueError;
use serde::{Deserialize, Serialize};

/// Role of a token; each role includes the rights of the one before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// May read, and may hold the machine.
    Viewer,
    /// May start, acknowledge, resume, answer prompts, report an armed cycle as due, and disarm cycles.
    Operator,
    /// May sign results, arm scheduled cycles, and decide which values are written to the control; may use every
    /// other route.
    Metrologist,
}

impl Role {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Operator => "operator",
            Self::Metrologist => "metrologist",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let role = Self::deserialize(text.into_deserializer());
        role.map_err(|_: ValueError| "the role must be viewer, operator or metrologist".to_owned())
    }
}

/// Route of the hold: open to every known token, and not limited in rate.
pub const HOLD_ROUTE: &str = "/api/v1/machines/{name}/hold";
/// Route of the sign-in page, open without a token.
pub const LOGIN_ROUTE: &str = "/login";

/// Minimum role for each route that changes something. A route that is not listed requires the highest role.
const MIN_ROLES_OF_CHANGING_ROUTES: [(&str, Role); 8] = [
    (HOLD_ROUTE, Role::Viewer),
    ("/logout", Role::Viewer),
    ("/api/v1/machines/{name}/start", Role::Operator),
    ("/api/v1/machines/{name}/acknowledge", Role::Operator),
    ("/api/v1/machines/{name}/resume", Role::Operator),
    ("/api/v1/machines/{name}/answer", Role::Operator),
    // Only a cycle that a metrologist has armed can start.
    ("/api/v1/machines/{name}/due", Role::Operator),
    ("/api/v1/machines/{name}/disarm", Role::Operator),
];

/// Minimum role for `route`. `is_read_only`: whether the request changes nothing; a viewer may make every such
/// request.
pub fn required_role(route: &str, is_read_only: bool) -> Role {
    if is_read_only {
        return Role::Viewer;
    }
    MIN_ROLES_OF_CHANGING_ROUTES.iter().find(|(known, _)| *known == route).map_or(Role::Metrologist, |(_, role)| *role)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_route_requires_the_highest_role() {
        assert_eq!(required_role("/api/v1/runs/{run}/sign", false), Role::Metrologist);
        assert_eq!(required_role("/api/v1/runs/{run}/sign", true), Role::Viewer);
        assert_eq!(required_role(HOLD_ROUTE, false), Role::Viewer);
        assert_eq!(required_role("/api/v1/machines/{name}/start", false), Role::Operator);
        assert!(Role::Viewer < Role::Operator && Role::Operator < Role::Metrologist);
    }
}
