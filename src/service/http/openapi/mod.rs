//! OpenAPI description of the HTTP API, generated from the routes: `/api/v1/openapi.json`, and the same in
//! `docs/openapi.json`.

pub mod schemas;

use axum::routing::get;
use axum::{Json, Router};
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    Components, ContentBuilder, Info, OpenApi, OpenApiBuilder, PathItem, Ref, RefOr, ResponseBuilder,
};
use utoipa::{PartialSchema, ToSchema};
use utoipa_axum::router::OpenApiRouter;

use super::problem::Problem;
use super::{AppState, actions, api, compensation, events, run_files, schedule};

/// Name of the security scheme.
const SECURITY_SCHEME_NAME: &str = "token";

/// Routes of the API, with that of its description.
pub fn openapi_routes() -> Router<AppState> {
    let (router, described) = describe_routes();
    router.route("/api/v1/openapi.json", get(move || async move { Json(described) }))
}

fn describe_routes() -> (Router<AppState>, OpenApi) {
    let mut components = Components::new();
    components.schemas.insert(Problem::name().into_owned(), Problem::schema());
    let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer);
    let bearer = bearer.description(Some("required if the configuration contains `tokens = true`"));
    components.add_security_scheme(SECURITY_SCHEME_NAME, SecurityScheme::Http(bearer.build()));
    let head = OpenApiBuilder::new().info(Info::new("trued", "1")).components(Some(components));
    let all = OpenApiRouter::with_openapi(head.build());
    let all = all.merge(api::api_routes()).merge(actions::action_routes()).merge(events::event_routes());
    let all = all.merge(schedule::schedule_routes()).merge(run_files::run_file_routes());
    let all = all.merge(compensation::compensation_routes());
    let (router, mut described) = all.split_for_parts();
    described.paths.paths.values_mut().flat_map(get_and_post_operations).for_each(add_security_and_error_response);
    (router, described)
}

fn get_and_post_operations(item: &mut PathItem) -> impl Iterator<Item = &mut Operation> {
    [item.get.as_mut(), item.post.as_mut()].into_iter().flatten()
}

/// Adds what every operation has: the token, a description of the response, and the response for an error.
fn add_security_and_error_response(operation: &mut Operation) {
    for answer in operation.responses.responses.values_mut() {
        if let RefOr::T(answer) = answer {
            answer.description = "the response".into();
        }
    }
    operation.security = Some(vec![SecurityRequirement::new::<_, [&str; 0], &str>(SECURITY_SCHEME_NAME, [])]);
    let problem = ContentBuilder::new().schema(Some(Ref::from_schema_name(Problem::name())));
    let refused = ResponseBuilder::new()
        .description("error: its reason and its remedy")
        .content("application/json", problem.build());
    operation.responses.responses.insert("default".to_owned(), refused.build().into());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Environment variable; if it is set, the test writes docs/openapi.json before the comparison.
    const WRITE_OPENAPI_ENV_VAR: &str = "TRUED_WRITE_OPENAPI";

    #[test]
    fn openapi_description_equals_the_stored_one() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/openapi.json");
        let text = describe_routes().1.to_pretty_json().unwrap() + "\n";
        if std::env::var_os(WRITE_OPENAPI_ENV_VAR).is_some() {
            std::fs::write(file, &text).unwrap();
        }
        let kept = std::fs::read_to_string(file).unwrap();
        assert!(kept == text, "{file} is out of date: run `{WRITE_OPENAPI_ENV_VAR}=1 cargo test --lib openapi`");
    }

    #[test]
    fn routes_are_get_or_post_with_a_description_and_an_error_response() {
        let described = serde_json::to_value(describe_routes().1).unwrap();
        let paths = described["paths"].as_object().unwrap();
        assert!(paths.len() >= 12, "{}", paths.len());
        for (path, item) in paths {
            for (method, operation) in item.as_object().unwrap() {
                assert!(["get", "post"].contains(&method.as_str()), "{method} {path}");
                assert!(operation["responses"]["default"].is_object(), "{method} {path}");
                assert!(operation["description"].is_string() || operation["summary"].is_string());
            }
        }
    }
}
